"""The pose of a sensor that its own views agree on, found again and again until it settles."""

import numpy as np

from calib.estimation import estimation_problem, measurement_groups, solver
from calib.geometry import se3
from calib.io import parquet_tables, table_schemas
from calib.io.status import OK, failed
from calib.views import frame_selection

LOOSE = {"gate_sigma": 6.0, "edge_margin_m": -1.0, "min_cosine": -1.0}
WORKING_ROUNDS, WORKING_POINTS = 12, 5000
ROUNDS, SETTLED = 8, 1e-6  # of extraction; the step of the working pose, m and rad, that ends them


def settle(job, at_pose, T_robot_sensor, noise):
    """(keypoints, outcomes, working pose), once the pose that the keypoints agree on is the one
    that they were taken at: what is found then depends on no guess.

    at_pose(T) -> (parts of the keypoints, outcomes). The pose is None where nothing was found.
    """
    T = T_robot_sensor
    for _ in range(ROUNDS):
        parts, outcomes = at_pose(T)
        keypoints = parquet_tables.concatenate(parts, table_schemas.KEYPOINTS)
        if not parts:
            return keypoints, outcomes, None
        before, T = T, working_pose(job, keypoints, T, job.associate, noise)
        if np.abs(se3.se3_log(se3.inverse(before) @ T)).max() < SETTLED:
            break
    return keypoints, outcomes, T


def in_view(job, views, T_robot_sensor, hidden):
    """{row of views: Status} of those kept: whether they count at a pose of the sensor, without
    any margin; hidden is that of crop.

    In view, and of the most different placements as many as are wanted.
    """
    kept, out = np.flatnonzero(views["kept"]), {}
    T_robot_target = {k: p.T_robot_body @ p.T_body_target for k, p in job.places.items()}
    for name, target in sorted(job.targets.items()):
        mine = (views["target"] == name) & (views["placement"] >= 0)
        numbers = np.unique(views["placement"][mine])
        T = np.reshape([T_robot_target[k] for k in numbers], (-1, 4, 4))
        room = job.crop["max_placements"]
        for number in numbers[frame_selection.new_poses(T, np.arange(len(T)), job.crop)]:
            rows = kept[mine[kept] & (views["placement"][kept] == number)]
            if len(rows) == 0:
                continue
            where = job.expected(number, T_robot_sensor)
            why = hidden(job.model, target, where, np.zeros(6), job.crop)
            room -= not why
            why = why or ("" if room >= 0 else "enough placements")
            out |= dict.fromkeys(rows.tolist(), failed(why) if why else OK)
    return out


def working_pose(job, keypoints, T_robot_sensor, associate, noise):
    """T_robot_sensor (4, 4) that the keypoints agree on, held where it was when they say nothing.

    noise: the factor on the keypoints' σ to start from, large where the start may be far off.
    Thinned to about WORKING_POINTS: it only says where to look.
    """
    keypoints = thinned(keypoints)
    used = sorted(set(keypoints["placement"].tolist()))
    index = {number: i for i, number in enumerate(used)}
    setup = estimation_problem.Setup(
        models={job.name: job.model},
        targets=job.targets,
        placements=[job.places[number] for number in used],
        groups=measurement_groups.groups(keypoints, job.name, index),
        associate=associate,
        prior={job.name: (T_robot_sensor, job.sigma)},
    )
    start = {job.name: T_robot_sensor}
    result = solver.estimate(setup, start, WORKING_ROUNDS, 1e-7, 1e-7, noise)
    return result.state.T_robot_sensor[job.name]


def thinned(keypoints):
    """One of 2, 4, 8 ... keypoints where there are many: returns by a lot drawn from their own
    coordinates, pixels by whole views. Whether one is in does not depend on which others are."""
    n = len(keypoints["view"])
    share = 2 ** int(np.ceil(np.log2(max(1.0, n / WORKING_POINTS))))
    bits = keypoints["xyz"].astype(np.float32).view(np.uint32).astype(np.uint64)
    lot = (bits * np.array([73856093, 19349663, 83492791], np.uint64)).sum(1) >> np.uint64(7)
    by_view = keypoints["view"].astype(np.uint64)
    lot = np.where(np.isnan(keypoints["xyz"][:, 0]), by_view, lot)
    return parquet_tables.select(keypoints, lot % np.uint64(share) == 0)
