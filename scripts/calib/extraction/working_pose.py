"""Find the pose of a sensor that its own views agree on, by extracting at each new pose."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.problem_assembly import SessionKeypoints, assemble_setup
from calib.estimation.solver import estimate_poses
from calib.extraction.extraction_inputs import ExtractionContext
from calib.extraction.extraction_results import Extraction, ViewKeypoints
from calib.geometry.se3 import invert_pose, se3_log
from calib.io.parquet_tables import select_rows
from calib.io.status import OK, Status, failure_status
from calib.views.field_of_view import PosedSensor, VisibilityCheck
from calib.views.placement_selection import select_placements
from calib.views.pose_selection import select_new_poses
from calib.views.target_placements import Columns

LOOSE_GATES = {"gate_sigma": 6.0, "edge_margin_m": -1.0, "min_cosine": -1.0}
MAX_WORKING_ROUNDS = 12  # of the estimate
WORKING_TOLERANCE = 1e-7  # m and rad, that ends the estimate
MAX_WORKING_KEYPOINTS = 5000
MAX_EXTRACTION_ROUNDS = 8
POSE_STEP_TOLERANCE = 1e-6  # m and rad, of the working pose, that ends the extraction
# Odd numbers, and the bits to drop, of a spatial hash of coordinates.
HASH_FACTORS = np.array([73856093, 19349663, 83492791], np.uint64)
HASH_SHIFT = np.uint64(7)


class WorkingPose(NamedTuple):
    """T_robot_sensor (4, 4), and the numbers of the views with measurements that agree with it."""

    T_robot_sensor: np.ndarray
    agreeing_views: frozenset[int]


def iterate_working_pose(
    context: ExtractionContext,
    views: Columns,
    extract_at_pose: Callable[[np.ndarray], Mapping[int, ViewKeypoints]],
    T_robot_sensor: np.ndarray,
    noise_factor: float,
) -> Extraction:
    """Extract until the pose that the keypoints agree on is the pose they were extracted at.

    The result then does not depend on the initial guess. extract_at_pose: results by row of views
    at a pose (4, 4). noise_factor: see estimate_working_pose.
    """
    T, agreeing_views = T_robot_sensor, frozenset[int]()
    for _ in range(MAX_EXTRACTION_ROUNDS):
        extraction = Extraction.collect(views, extract_at_pose(T), T)
        if not extraction.n_keypoints:
            return Extraction(extraction.keypoints, extraction.outcomes)
        previous = T
        T, agreeing_views = estimate_working_pose(
            context, extraction.keypoints, T, context.associate_options, noise_factor=noise_factor
        )
        if np.abs(se3_log(invert_pose(previous) @ T)).max() < POSE_STEP_TOLERANCE:
            break
    return Extraction(extraction.keypoints, extraction.outcomes, T, agreeing_views)


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
    outcomes: dict[int, Status] = {}
    for name, target in sorted(context.targets.items()):
        rows = _kept_rows_by_placement(views, name, T_robot_target, context.crop_options)
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


def _kept_rows_by_placement(
    views: Columns,
    target_name: str,
    T_robot_target: Mapping[int, np.ndarray],
    crop_options: dict[str, Any],
) -> dict[int, np.ndarray]:
    """Return the rows of the kept views of one target by new placement, most different first."""
    is_of_target = (views["target"] == target_name) & (views["placement"] >= 0)
    numbers = np.unique(views["placement"][is_of_target])
    poses = np.reshape([T_robot_target[k] for k in numbers], (-1, 4, 4))
    order = select_new_poses(poses, np.arange(len(poses)), crop_options)
    is_kept = is_of_target & views["kept"]
    return {
        int(number): np.flatnonzero(is_kept & (views["placement"] == number))
        for number in numbers[order]
    }


def estimate_working_pose(
    context: ExtractionContext,
    keypoints: Columns,
    T_robot_sensor: np.ndarray,
    associate_options: dict[str, Any],
    *,
    noise_factor: float,
) -> WorkingPose:
    """Return T_robot_sensor that the keypoints agree on.

    The start T_robot_sensor (4, 4) has the σ of the initial guess as prior. noise_factor: factor on
    the σ of the keypoints to begin with, large if the start may be far off. The keypoints are
    thinned, because the pose only says where to look.
    """
    all_views = np.unique(keypoints["view"])
    keypoints = thin_keypoints(keypoints)
    setup = _assemble_working_setup(context, keypoints, T_robot_sensor, associate_options)
    result = estimate_poses(
        setup,
        {context.name: T_robot_sensor},
        max_rounds=MAX_WORKING_ROUNDS,
        tolerance_m=WORKING_TOLERANCE,
        tolerance_rad=WORKING_TOLERANCE,
        initial_noise_factor=noise_factor,
    )
    # Views without thinned keypoints say nothing against the pose.
    unseen = np.setdiff1d(all_views, keypoints["view"])
    views = frozenset(unseen.tolist()) | _list_agreeing_views(setup, result)
    return WorkingPose(result.state.T_robot_sensor[context.name], views)


def _assemble_working_setup(
    context: ExtractionContext,
    keypoints: Columns,
    T_robot_sensor: np.ndarray,
    associate_options: dict[str, Any],
) -> Setup:
    """Return the Setup of one sensor, with the σ of its guess as prior about a pose (4, 4)."""
    session = SessionKeypoints(
        session="",
        keypoints=keypoints | {"sensor": np.full(len(keypoints["view"]), context.name)},
        placements=context.placements,
        T_robot_sensor={context.name: T_robot_sensor},
    )
    return assemble_setup(
        [session],
        models={context.name: context.model},
        targets=context.targets,
        associate_options=associate_options,
        sensor_priors={context.name: (T_robot_sensor, context.guess_sigma)},
    )


def _list_agreeing_views(setup: Setup, result: EstimationResult) -> frozenset[int]:
    """Return the numbers of the views with a measurement that is used."""
    used = [
        group.keypoints["view"][assignment.feature >= 0]
        for group, assignment in zip(setup.groups, result.assignments, strict=True)
    ]
    return frozenset(np.concatenate(used).tolist())


def thin_keypoints(keypoints: Columns) -> Columns:
    """Return one of 2, 4, 8 ... keypoints if there are many.

    Returns are chosen by a hash of their own coordinates, pixels by whole views, so that the choice
    of one does not depend on which others there are.
    """
    n = len(keypoints["view"])
    share = 2 ** int(np.ceil(np.log2(max(1.0, n / MAX_WORKING_KEYPOINTS))))
    bits = keypoints["xyz"].astype(np.float32).view(np.uint32).astype(np.uint64)
    hashes = (bits * HASH_FACTORS).sum(1) >> HASH_SHIFT
    views = keypoints["view"].astype(np.uint64)
    hashes = np.where(np.isnan(keypoints["xyz"][:, 0]), views, hashes)
    return select_rows(keypoints, hashes % np.uint64(share) == 0)
