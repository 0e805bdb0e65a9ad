"""The pose of a sensor that its own views agree on, found again and again until it settles."""

import numpy as np

from calib.estimation.estimation_problem import Setup
from calib.estimation.measurement_groups import group_keypoints
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import invert_pose, se3_log
from calib.io.parquet_tables import concatenate_columns, select_rows
from calib.io.status import OK, failure_status
from calib.io.table_schemas import KEYPOINTS_SCHEMA
from calib.views.frame_selection import select_new_poses

LOOSE_GATES = {"gate_sigma": 6.0, "edge_margin_m": -1.0, "min_cosine": -1.0}
MAX_WORKING_ROUNDS, MAX_WORKING_KEYPOINTS = 12, 5000
MAX_EXTRACTION_ROUNDS, POSE_STEP_TOLERANCE = (
    8,
    1e-6,
)  # of extraction; the step of the working pose, m and rad, that ends them


def iterate_working_pose(context, at_pose, T_robot_sensor, noise_factor):
    """(keypoints, outcomes, working pose), once the pose that the keypoints agree on is the one
    that they were taken at: what is found then depends on no guess.

    at_pose(T) -> (parts of the keypoints, outcomes). The pose is None where nothing was found.
    """
    T = T_robot_sensor
    for _ in range(MAX_EXTRACTION_ROUNDS):
        parts, outcomes = at_pose(T)
        keypoints = concatenate_columns(parts, KEYPOINTS_SCHEMA)
        if not parts:
            return keypoints, outcomes, None
        before, T = (
            T,
            estimate_working_pose(context, keypoints, T, context.associate_options, noise_factor),
        )
        if np.abs(se3_log(invert_pose(before) @ T)).max() < POSE_STEP_TOLERANCE:
            break
    return keypoints, outcomes, T


def check_kept_views(context, views, T_robot_sensor, check_visibility):
    """{row of views: Status} of those kept: whether they count at a pose of the sensor, without
    any margin; hidden is that of crop.

    In view, and of the most different placements as many as are wanted.
    """
    kept, out = np.flatnonzero(views["kept"]), {}
    T_robot_target = {k: p.T_robot_body @ p.T_body_target for k, p in context.placements.items()}
    for name, target in sorted(context.targets.items()):
        mine = (views["target"] == name) & (views["placement"] >= 0)
        numbers = np.unique(views["placement"][mine])
        T = np.reshape([T_robot_target[k] for k in numbers], (-1, 4, 4))
        room = context.crop_options["max_placements"]
        for number in numbers[select_new_poses(T, np.arange(len(T)), context.crop_options)]:
            rows = kept[mine[kept] & (views["placement"][kept] == number)]
            if len(rows) == 0:
                continue
            where = context.predict_target_pose(number, T_robot_sensor)
            why = check_visibility(context.model, target, where, np.zeros(6), context.crop_options)
            room -= not why
            why = why or ("" if room >= 0 else "enough placements")
            out |= dict.fromkeys(rows.tolist(), failure_status(why) if why else OK)
    return out


def estimate_working_pose(context, keypoints, T_robot_sensor, associate, noise_factor):
    """T_robot_sensor (4, 4) that the keypoints agree on, held where it was when they say nothing.

    noise_factor: the factor on the keypoints' σ to start from, large where the start may be far off.
    Thinned to about WORKING_POINTS: it only says where to look.
    """
    keypoints = thin_keypoints(keypoints)
    used = sorted(set(keypoints["placement"].tolist()))
    index = {number: i for i, number in enumerate(used)}
    setup = Setup(
        models={context.name: context.model},
        targets=context.targets,
        placements=[context.placements[number] for number in used],
        groups=group_keypoints(keypoints, context.name, index),
        associate_options=associate,
        sensor_priors={context.name: (T_robot_sensor, context.guess_sigma)},
    )
    start = {context.name: T_robot_sensor}
    result = estimate_poses(setup, start, MAX_WORKING_ROUNDS, 1e-7, 1e-7, noise_factor)
    return result.state.T_robot_sensor[context.name]


def thin_keypoints(keypoints):
    """One of 2, 4, 8 ... keypoints where there are many: returns by a lot drawn from their own
    coordinates, pixels by whole views. Whether one is in does not depend on which others are."""
    n = len(keypoints["view"])
    share = 2 ** int(np.ceil(np.log2(max(1.0, n / MAX_WORKING_KEYPOINTS))))
    bits = keypoints["xyz"].astype(np.float32).view(np.uint32).astype(np.uint64)
    lot = (bits * np.array([73856093, 19349663, 83492791], np.uint64)).sum(1) >> np.uint64(7)
    by_view = keypoints["view"].astype(np.uint64)
    lot = np.where(np.isnan(keypoints["xyz"][:, 0]), by_view, lot)
    return select_rows(keypoints, lot % np.uint64(share) == 0)
