"""The pose of a sensor that its own views agree on, found again and again until it settles."""

import numpy as np

from calib.estimation.problem_assembly import SessionKeypoints, assemble_setup
from calib.estimation.solver import estimate_poses
from calib.extraction.extraction_inputs import ExtractionContext
from calib.geometry.se3 import invert_pose, se3_log
from calib.io.parquet_tables import concatenate_columns, select_rows
from calib.io.status import OK, Status, failure_status
from calib.io.table_schemas import KEYPOINTS_SCHEMA
from calib.views.field_of_view import PosedSensor, VisibilityCheck
from calib.views.placement_selection import select_placements
from calib.views.pose_selection import select_new_poses
from calib.views.target_placements import Columns

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


def check_kept_views(
    context: ExtractionContext,
    views: Columns,
    T_robot_sensor: np.ndarray,
    check_visibility: VisibilityCheck,
) -> dict[int, Status]:
    """Return for each kept view (row) whether it is used at a pose of the sensor, without margin.

    A view is used if its target is in view, in as many of the most different placements as wanted.
    """
    sensor = PosedSensor(context.model, check_visibility, T_robot_sensor, margin=np.zeros(6))
    T_robot_target = {k: p.T_robot_body @ p.T_body_target for k, p in context.placements.items()}
    kept, outcomes = np.flatnonzero(views["kept"]), {}
    for name, target in sorted(context.targets.items()):
        is_of_target = (views["target"] == name) & (views["placement"] >= 0)
        numbers = np.unique(views["placement"][is_of_target])
        poses = np.reshape([T_robot_target[k] for k in numbers], (-1, 4, 4))
        rows = {
            int(number): kept[is_of_target[kept] & (views["placement"][kept] == number)]
            for number in numbers[
                select_new_poses(poses, np.arange(len(poses)), context.crop_options)
            ]
        }
        reasons = select_placements(
            sensor,
            target,
            T_robot_target,
            [number for number in rows if len(rows[number])],
            context.crop_options,
            n_max=context.crop_options["max_placements"],
        )
        for number, reason in reasons.items():
            status = failure_status(reason) if reason else OK
            outcomes |= dict.fromkeys(rows[number].tolist(), status)
    return outcomes


def estimate_working_pose(context, keypoints, T_robot_sensor, associate, noise_factor):
    """T_robot_sensor (4, 4) that the keypoints agree on, held where it was when they say nothing.

    noise_factor: the factor on the keypoints' σ to start from, large where the start may be far off.
    Thinned to about WORKING_POINTS: it only says where to look.
    """
    keypoints = thin_keypoints(keypoints)
    start = {context.name: T_robot_sensor}
    session = SessionKeypoints(
        session="",
        keypoints=keypoints | {"sensor": np.full(len(keypoints["view"]), context.name)},
        placements=context.placements,
        T_robot_sensor=start,
    )
    setup = assemble_setup(
        [session],
        models={context.name: context.model},
        targets=context.targets,
        associate_options=associate,
        sensor_priors={context.name: (T_robot_sensor, context.guess_sigma)},
    )
    result = estimate_poses(
        setup,
        start,
        max_rounds=MAX_WORKING_ROUNDS,
        tolerance_m=1e-7,
        tolerance_rad=1e-7,
        initial_noise_factor=noise_factor,
    )
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
