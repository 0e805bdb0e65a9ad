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

from calib import assembly, gain, lenses, markers, refinement, solution, stage, tables
from calib.sessions import repeatability
from calib.stage import logger


def read_sessions(args, options):
    """{session: (pairs columns, notes, Placements by number)}, and the mounts that guess found:
    T_body_target (4, 4) to start from, by target."""
    read = [tables.read(path, tables.PAIRS) for path in args.pairs]
    mounts = assembly.found_mounts([notes for _, _, notes in read])
    out, anew = {}, options["remounted"]
    for session, (pairs, _, notes), path in zip(
        options["sessions"], read, args.placements, strict=True
    ):
        table, _, _ = tables.read(path, tables.PLACEMENTS)
        out[session] = pairs, notes, assembly.still(table, session, notes, mounts, options)
    # Those whose markers define R come first: their sensors' poses are in it.
    return {s: out[s] for s in sorted(out, key=lambda s: (s in anew, s))}, mounts


def read_motion(args, options):
    """{session: (columns of the MCS's poses, topics by body, {sensor: columns of its views in
    motion})}."""
    files, out = iter(args.tracked), {}
    for session, path in zip(options["sessions"], args.mocap, strict=True):
        sensors = options["used"][session]
        tracked = {name: tables.read(next(files), tables.KEYPOINTS)[0] for name in sensors}
        poses, _, notes = tables.read(path, tables.MOCAP)
        out[session] = poses, notes["topics"], tracked
    return out


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
    setup, start = assembly.setup_of(sessions, mounts, options)
    notes = {s: found for s, (_, found, _) in sessions.items()}
    setup = replace(setup, corrections=tuple(markers.corrections(notes, options["remounted"])))
    wanted, most = options["solve"]["estimate"], assembly.limits(setup, options["solve"])
    moving = partial(
        assembly.with_motion, seen=read_motion(args, options), sessions=sessions, options=options
    )
    setup, result, suspected = refinement.estimate(setup, start, wanted, moving, **most)
    known = assembly.statuses(sessions, options)
    content = solution.as_json(setup, result, suspected, known, options)
    content["sessions"] |= markers.told(setup, result) if result.solution else {}
    placed = [n for n, sensor in content["sensors"].items() if sensor["T_robot_sensor"]]
    views = gain.best_views(setup, result, placed, options["views"])
    for name, sensor in content["sensors"].items():
        sensor["next_view"] = views.get(name)
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
