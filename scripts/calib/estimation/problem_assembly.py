"""Everything that the sessions of a rig measured, as one Setup.

Sessions stand as name -> (columns of pairs.parquet, its notes by sensor, Placements by number).
"""

from dataclasses import replace

import numpy as np

from calib.estimation.corrections.clock_offset import TimeOffsetCorrection
from calib.estimation.estimation_problem import Setup
from calib.estimation.measurement_groups import group_keypoints, make_still_placements
from calib.estimation.moving_view_poses import build_moving_groups
from calib.estimation.residuals.residual_registry import uses_template_points
from calib.io.parquet_tables import select_rows
from calib.io.pose_block import pose_sigma_from_config
from calib.io.status import Status
from calib.mocap.body_trajectory import find_separate_streams, target_trajectories
from calib.sensors.sensor_models import sensor_model_from_config
from calib.targets.target_shapes import target_from_config


def mounts_from_guesses(sessions):
    """{target: T_body_target (4, 4)} of the first guess that found it; sessions: their notes."""
    mounts = {}
    for notes in sessions:
        for _, note in sorted(notes.items()):
            for target, mount in sorted(note["guess"]["mounts"].items()):
                mounts.setdefault(target, np.array(mount["T_body_target"]["matrix"]))
    return mounts


def read_session_placements(table, session, notes, mounts, options):
    """The Placements by number of a session, from the columns of placements.parquet."""
    late = max(n["guess"]["time_offset_s"]["sigma"] for n in notes.values())
    return make_still_placements(table, session, options["targets"], options["mocap"], mounts, late)


def build_setup(sessions, mounts, options):
    """The Setup of everything that was measured, and each sensor's pose to start from."""
    places, groups, start = [], [], {}
    for pairs, notes, numbered in sessions.values():
        used = sorted(set(np.asarray(pairs["placement"]).tolist()))
        index = {number: len(places) + i for i, number in enumerate(used)}
        places += [numbered[number] for number in used]
        for name in sorted(set(np.asarray(pairs["sensor"]).tolist())):
            rows = select_rows(pairs, pairs["sensor"] == name)
            groups += group_keypoints(rows, name, index)
            start.setdefault(name, np.array(notes[name]["T_robot_sensor"]))
    setup = Setup(
        models={n: sensor_model_from_config(options["sensors"][n]) for n in start},
        targets={n: target_from_config(c) for n, c in options["targets"].items()},
        placements=places,
        groups=groups,
        associate_options=options["associate"],
        sensor_priors={},
        initial_mounts={n: T for n, T in mounts.items() if any(p.target == n for p in places)},
        estimable_intrinsics={
            n: len(options["sensors"][n].get("params", ()))
            for n in start
            if options["sensors"][n]["kind"] == "camera"
        },
        mount_sigma={
            n: pose_sigma_from_config(c["alignment_sigma"])
            for n, c in options["targets"].items()
            if "alignment_sigma" in c and n not in mounts
        },
    )
    return setup, start


def add_moving_views(setup, moving_by_session, sessions, options):
    """The Setup with the views of targets in motion, and the clocks that they tell; moving_by_session: session
    -> (columns of mocap.parquet, topics by body, {sensor: columns of moving_keypoints.parquet})."""
    places, groups = list(setup.placements), list(setup.groups)
    for session, (poses, topics, tracked) in moving_by_session.items():
        known = {p.target: p.T_body_target for p in setup.placements if p.session == session}
        bodies = {n: c["body"] for n, c in options["targets"].items() if n in known}
        paths = target_trajectories(poses, options["body"], bodies, options["max_gap_s"])
        stated = options["body"], bodies, topics, options["max_gap_s"]
        streams = find_separate_streams(poses, *stated)
        for name, columns in tracked.items():
            columns = select_rows(columns, np.isin(columns["target"], list(known)))
            if name in setup.models and len(columns["view"]):
                late = best_time_offset_guess(name, sessions)["value"]
                about = session, name, late, paths, streams, known, options["mocap"], len(places)
                found = build_moving_groups(columns, *about)
                places, groups = places + found[0], groups + found[1]
    timed = sorted({g.sensor for g in groups if g.is_moving})
    clock = [
        TimeOffsetCorrection(n, np.array([best_time_offset_guess(n, sessions)["sigma"]]))
        for n in timed
    ]
    corrections = (*setup.corrections, *clock)
    return replace(setup, placements=places, groups=groups, corrections=corrections)


def best_time_offset_guess(name, sessions):
    """The best guess of a sensor's offset, {value, sigma, source}, of all sessions: clocks may
    wander from one to the next, but by less than guesses are off."""
    notes = [found[name] for _, found, _ in sessions.values() if name in found]
    return min((n["guess"]["time_offset_s"] for n in notes), key=lambda g: g["sigma"])


def statuses_before_solve(sessions, options):
    """Per sensor what came of it before the solve: ok if any session saw it, and its guess."""
    out = {}
    for name in options["sensors"]:
        found = [notes[name] for _, notes, _ in sessions.values() if name in notes]
        best = next((n for n in found if n["status"]["ok"]), found[0])
        guess = best["guess"] | {"time_offset_s": best_time_offset_guess(name, sessions)}
        out[name] = Status.from_dict(best["status"]), guess
    return out


def iteration_limits(setup, options):
    """Most rounds, the step in m and rad below which the estimate has settled, and times how much
    of the configured noise it begins with."""
    by_points = any(uses_template_points(g.kind) for g in setup.groups)
    prefix = "points_" if by_points else ""
    steps = {f"tolerance_{u}": options[f"{prefix}tolerance_{u}"] for u in ("m", "rad")}
    return {"max_rounds": options["max_rounds"], "initial_noise_factor": 10.0, **steps}
