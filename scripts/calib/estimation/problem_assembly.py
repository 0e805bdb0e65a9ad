"""Everything that the sessions of a rig measured, as one Setup.

Sessions stand as name -> (columns of pairs.parquet, its notes by sensor, Placements by number).
"""

from dataclasses import replace

import numpy as np

from calib.estimation import estimation_problem, measurement_groups, moving_view_poses
from calib.estimation.corrections import clock_offset
from calib.estimation.residuals import residual_registry
from calib.io import parquet_tables, pose_block
from calib.io.status import Status
from calib.mocap import body_trajectory
from calib.sensors import sensor_models
from calib.targets import target_shapes


def found_mounts(sessions):
    """{target: T_body_target (4, 4)} of the first guess that found it; sessions: their notes."""
    mounts = {}
    for notes in sessions:
        for _, note in sorted(notes.items()):
            for target, mount in sorted(note["guess"]["mounts"].items()):
                mounts.setdefault(target, np.array(mount["T_body_target"]["matrix"]))
    return mounts


def still(table, session, notes, mounts, options):
    """The Placements by number of a session, from the columns of placements.parquet."""
    late = max(n["guess"]["time_offset_s"]["sigma"] for n in notes.values())
    return measurement_groups.still(
        table, session, options["targets"], options["mocap"], mounts, late
    )


def setup_of(sessions, mounts, options):
    """The Setup of everything that was measured, and each sensor's pose to start from."""
    places, groups, start = [], [], {}
    for pairs, notes, numbered in sessions.values():
        used = sorted(set(np.asarray(pairs["placement"]).tolist()))
        index = {number: len(places) + i for i, number in enumerate(used)}
        places += [numbered[number] for number in used]
        for name in sorted(set(np.asarray(pairs["sensor"]).tolist())):
            rows = parquet_tables.select(pairs, pairs["sensor"] == name)
            groups += measurement_groups.groups(rows, name, index)
            start.setdefault(name, np.array(notes[name]["T_robot_sensor"]))
    setup = estimation_problem.Setup(
        models={n: sensor_models.model(options["sensors"][n]) for n in start},
        targets={n: target_shapes.from_config(c) for n, c in options["targets"].items()},
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
            n: pose_block.pose_sigma(c["alignment_sigma"])
            for n, c in options["targets"].items()
            if "alignment_sigma" in c and n not in mounts
        },
    )
    return setup, start


def with_motion(setup, seen, sessions, options):
    """The Setup with the views of targets in motion, and the clocks that they tell; seen: session
    -> (columns of mocap.parquet, topics by body, {sensor: columns of tracked.parquet})."""
    places, groups = list(setup.placements), list(setup.groups)
    for session, (poses, topics, tracked) in seen.items():
        known = {p.target: p.T_body_target for p in setup.placements if p.session == session}
        bodies = {n: c["body"] for n, c in options["targets"].items() if n in known}
        paths = body_trajectory.trajectories(poses, options["body"], bodies, options["max_gap_s"])
        stated = options["body"], bodies, topics, options["max_gap_s"]
        streams = body_trajectory.apart(poses, *stated)
        for name, columns in tracked.items():
            columns = parquet_tables.select(columns, np.isin(columns["target"], list(known)))
            if name in setup.models and len(columns["view"]):
                late = clock_guess(name, sessions)["value"]
                about = session, name, late, paths, streams, known, options["mocap"], len(places)
                found = moving_view_poses.seen(columns, *about)
                places, groups = places + found[0], groups + found[1]
    timed = sorted({g.sensor for g in groups if g.moving})
    clock = [clock_offset.clock(n, clock_guess(n, sessions)["sigma"]) for n in timed]
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
    by_points = any(residual_registry.by_nearest_point(g.kind) for g in setup.groups)
    prefix = "points_" if by_points else ""
    steps = {f"tolerance_{u}": options[f"{prefix}tolerance_{u}"] for u in ("m", "rad")}
    return {"max_rounds": options["max_rounds"], "noise": 10.0, **steps}
