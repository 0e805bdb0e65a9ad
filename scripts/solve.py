"""All sensors, targets and sessions of a rig in one problem.

Reads   pairs.parquet, placements.parquet and mocap.parquet of all its sessions, tracked.parquet of
        all their sensors
Writes  solution.json       poses, joint covariance, noise, observability, a status per sensor
        residuals.parquet   one row per measurement
        iterations.parquet  one row per round of solving and re-association
Decides which measurements are members, with the library function that associate uses, until
nothing moves. A sensor that the data cannot place gets no pose, and stops no other.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from calib import (
    chain,
    clocks,
    gain,
    kinds,
    lenses,
    markers,
    placements,
    refinement,
    rig,
    solution,
    stage,
    tables,
    targets,
    tracking,
)
from calib.sessions import repeatability
from calib.stage import logger
from calib.status import Status


def read_sessions(args, options):
    """(pairs columns, notes, placements by number) of every session, by name, and the mounts that
    guess found: T_body_target (4, 4) to start from, by target."""
    read = [tables.read(path, tables.PAIRS) for path in args.pairs]
    mounts = found_mounts([notes for _, _, notes in read])
    out, anew = {}, options["remounted"]
    for session, (pairs, _, notes), path in zip(
        options["sessions"], read, args.placements, strict=True
    ):
        table, _, _ = tables.read(path, tables.PLACEMENTS)
        late = max(options["sensors"][n]["time_offset_sigma_s"] for n in options["used"][session])
        known = options["targets"], options["mocap"], mounts, late
        out[session] = pairs, notes, placements.still(table, session, *known)
    # Those whose markers define R come first: their sensors' poses are in it.
    return {s: out[s] for s in sorted(out, key=lambda s: (s in anew, s))}, mounts


def found_mounts(sessions):
    """{target: T_body_target (4, 4)} of the first guess that found it; sessions: their notes."""
    mounts = {}
    for notes in sessions:
        for _, note in sorted(notes.items()):
            for target, mount in sorted(note["guess"]["mounts"].items()):
                mounts.setdefault(target, np.array(mount["T_body_target"]["matrix"]))
    return mounts


def setup_of(sessions, mounts, options):
    """The Setup of everything that was measured, and each sensor's pose to start from."""
    places, groups, start = [], [], {}
    for pairs, notes, numbered in sessions.values():
        used = sorted(set(np.asarray(pairs["placement"]).tolist()))
        index = {number: len(places) + i for i, number in enumerate(used)}
        places += [numbered[number] for number in used]
        for name in sorted(set(np.asarray(pairs["sensor"]).tolist())):
            rows = tables.select(pairs, pairs["sensor"] == name)
            groups += placements.groups(rows, name, index)
            start.setdefault(name, np.array(notes[name]["T_robot_sensor"]))
    setup = chain.Setup(
        models={n: rig.model(options["sensors"][n]) for n in start},
        targets={n: targets.from_config(c) for n, c in options["targets"].items()},
        placements=places,
        groups=groups,
        associate=options["associate"],
        prior={},
        mounts={n: T for n, T in mounts.items() if any(p.target == n for p in places)},
        lenses={
            n: len(options["sensors"][n].get("params", ()))
            for n in start
            if options["sensors"][n]["kind"] == "camera"
        },
        alignment={
            n: rig.pose_sigma(c["alignment_sigma"])
            for n, c in options["targets"].items()
            if "alignment_sigma" in c and n not in mounts
        },
    )
    return setup, start


def with_motion(setup, args, sessions, options):
    """The Setup with the views of targets in motion, and the clocks that they tell."""
    files, places, groups = iter(args.tracked), list(setup.placements), list(setup.groups)
    for session, poses in zip(options["sessions"], args.mocap, strict=True):
        known = {p.target: p.T_body_target for p in setup.placements if p.session == session}
        bodies = {n: c["body"] for n, c in options["targets"].items() if n in known}
        columns, _, _ = tables.read(poses, tables.MOCAP)
        paths = tracking.trajectories(columns, options["body"], bodies, options["max_gap_s"])
        for name in options["used"][session]:
            tracked, _, _ = tables.read(next(files), tables.KEYPOINTS)
            tracked = tables.select(tracked, np.isin(tracked["target"], list(known)))
            if name in setup.models and len(tracked["view"]):
                late = clock_guess(name, sessions)["value"]
                given = session, name, late, paths, known, options["mocap"], len(places)
                found = tracking.seen(tracked, *given)
                places, groups = places + found[0], groups + found[1]
    seen = sorted({g.sensor for g in groups if g.moving})
    clock = [clocks.clock(n, clock_guess(n, sessions)["sigma"]) for n in seen]
    corrections = (*setup.corrections, *clock)
    return replace(setup, placements=places, groups=groups, corrections=corrections)


def clock_guess(name, sessions):
    """The best guess of a sensor's offset, {value, sigma, source}, of all sessions: clocks may
    wander from one to the next, but by less than guesses are off."""
    notes = [found[name] for _, found, _ in sessions.values() if name in found]
    return min((n["guess"]["time_offset_s"] for n in notes), key=lambda g: g["sigma"])


def statuses(sessions, options):
    """Per sensor what came of it before the solve: ok if any session saw it, and its guess."""
    out = {}
    for name in options["sensors"]:
        found = [notes[name] for _, notes, _ in sessions.values() if name in notes]
        best = next((n for n in found if n["status"]["ok"]), found[0])
        guess = best["guess"] | {"time_offset_s": clock_guess(name, sessions)}
        out[name] = Status.from_dict(best["status"]), guess
    return out


def limits(setup, options):
    """Most rounds, the step in m and rad below which the estimate has settled, and times how much
    of the configured noise it begins with."""
    by_points = any(kinds.by_nearest_point(g.kind) for g in setup.groups)
    prefix = "points_" if by_points else ""
    steps = {f"tolerance_{u}": options[f"{prefix}tolerance_{u}"] for u in ("m", "rad")}
    return {"max_rounds": options["max_rounds"], "noise": 10.0, **steps}


def main(argv=None):
    args = stage.parser(
        __doc__,
        pairs="*input, one per session",
        placements="*input, one per session",
        mocap="*input, one per session",
        tracked="*input, one per sensor of every session",
        solution="output",
        residuals="output",
        iterations="output",
        options="slice of the config",
    ).parse_args(argv)
    options = args.options
    sessions, mounts = read_sessions(args, options)
    sessions = lenses.agreed(sessions)
    guesses = ((n, note["guess"]) for _, notes, _ in sessions.values() for n, note in notes.items())
    options["sensors"] = lenses.told(options["sensors"], guesses)
    setup, start = setup_of(sessions, mounts, options)
    notes = {s: found for s, (_, found, _) in sessions.items()}
    setup = replace(setup, corrections=tuple(markers.corrections(notes, options["remounted"])))
    wanted, most = options["solve"]["estimate"], limits(setup, options["solve"])
    moving = partial(with_motion, args=args, sessions=sessions, options=options)
    moving = moving if wanted["time_offset"] == "auto" else None
    setup, result, suspected = refinement.estimate(setup, start, wanted, moving, **most)
    known = statuses(sessions, options)
    content = solution.as_json(setup, result, suspected, known, options)
    content["sessions"] |= markers.told(setup, result) if result.solution else {}
    for name, sensor in content["sensors"].items():
        known = setup, result, name, options["views"]
        sensor["next_view"] = gain.best_view(*known) if sensor["T_robot_sensor"] else None
    content["repeatability"] = repeatability(setup, result, **most)
    stage.write_json(args.solution, content)
    tables.write(args.residuals, tables.RESIDUALS, solution.residuals(setup, result))
    rounds = {k: [r[k] for r in result.rounds] for k in tables.ITERATIONS.names}
    tables.write(args.iterations, tables.ITERATIONS, rounds)
    for r in result.rounds:
        logger.info(
            "round %(round)d: cost %(cost).6g, %(ipopt_iterations)d iterations, "
            "%(members)d members, %(changed)d changed, step %(step_m).1e m %(step_rad).1e rad",
            r,
        )
    logger.info("settled" if result.settled else "not settled")
    for h in setup.corrections:
        logger.info("estimated besides: %s of %s", h.name, h.of)
    for target in sorted(set(setup.mounts) & set(setup.alignment)):
        logger.info("estimated besides: T_body_target of %s", target)


if __name__ == "__main__":
    stage.run(main)
