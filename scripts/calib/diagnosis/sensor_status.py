"""Status of each sensor after the solve: whether the data determine its pose, and what to do."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.diagnosis.observability import advise_views
from calib.diagnosis.residual_statistics import sensor_groups, target_directions
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.pose_chain import T_sensor_target, model_with_corrections
from calib.estimation.residuals.pattern_corner import score_labellings
from calib.geometry.se3 import transform_points
from calib.initial_guess.hand_eye import check_mount_placements, name_target_in_status
from calib.io.status import OK, Status, failure_status
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel

# Misfit of another labelling over the stated one, below which the other is what was printed.
MAX_FLIPPED_MISFIT_RATIO = 0.3


@dataclass(frozen=True)
class FlippedPattern:
    """A pattern that a camera sees counted from another end than the config says.

    The misfits are distances of the corners from their places, px.
    """

    target: str
    first_square_color: str
    stated_misfit_px: float
    flipped_misfit_px: float


def sensor_status(
    setup: Setup, result: EstimationResult, sensor: str, undetermined: list[str]
) -> Status:
    """Return the status of a sensor of the setup. undetermined: descriptions of directions."""
    if undetermined:
        if flipped := find_flipped_pattern(sensor, setup, result):
            return flipped_pattern_status(sensor, flipped)
        return failure_status(
            f"the data do not determine {sensor}: {'; '.join(undetermined)}",
            f"{len(undetermined)} undetermined directions",
            "none",
            recording_advice(sensor, setup, result),
        )
    if not result.solved.has_converged:
        return failure_status(f"IPOPT ended with {result.solved.status}", remedy="See solve.log.")
    return OK


def find_floating_sensors(
    targets_by_sensor: Mapping[str, Collection[str]], T_robot_body: Mapping[str, np.ndarray]
) -> dict[str, Status]:
    """Return a status for each sensor whose targets have unknown mounts that nothing determines.

    targets_by_sensor: names of the targets that each sensor sees. T_robot_body: (n, 4, 4) of the
    placements of each target with unknown mount. A mount is determined by rotations of its target
    about two axes, or by a sensor that also sees another target whose mount is known.
    """
    open_mounts = {name: check_mount_placements(T, False) for name, T in T_robot_body.items()}
    open_mounts = {name: status for name, status in open_mounts.items() if not status.ok}
    floating = {name: set(seen) for name, seen in targets_by_sensor.items() if seen}
    while held := [n for n, seen in floating.items() if not seen <= set(open_mounts)]:
        for sensor in held:
            for target in floating.pop(sensor):
                open_mounts.pop(target, None)
    return {
        sensor: name_target_in_status(open_mounts[min(seen)], min(seen))
        for sensor, seen in floating.items()
    }


def find_floating_sensors_of_setup(setup: Setup) -> dict[str, Status]:
    """Return the floating sensors (find_floating_sensors) of a setup.

    A mount with a stated alignment_sigma is known to that, even where it is estimated.
    """
    targets_by_sensor: dict[str, set[str]] = {name: set() for name in setup.models}
    for group in setup.groups:
        targets_by_sensor[group.sensor].add(setup.placements[group.placement].target)
    T_robot_body = {
        name: np.array([p.T_robot_body for p in setup.placements if p.target == name])
        for name in setup.initial_mounts
        if name not in setup.mount_sigma
    }
    return find_floating_sensors(targets_by_sensor, T_robot_body)


def flipped_pattern_status(sensor: str, flipped: FlippedPattern) -> Status:
    """Return the status of a camera that sees a pattern counted from another end."""
    stated, target = flipped.first_square_color, flipped.target
    other = {"black": "white", "white": "black"}[stated]
    return failure_status(
        f"{sensor} sees the pattern of {target} the other way round than configured",
        f"corners {flipped.flipped_misfit_px:.1f} px from their places with a {other} first square",
        f"a {stated} first square, with which they are {flipped.stated_misfit_px:.0f} px off",
        f"Set first_square of {target} to {other}. If the pattern should begin with {stated}, it "
        "was printed or mounted mirrored: print it again without mirroring.",
    )


def recording_advice(sensor: str, setup: Setup, result: EstimationResult) -> str:
    """Return which views would improve the pose of a sensor."""
    directions, n_placements = target_directions(sensor, setup, result)
    is_lidar = isinstance(setup.models[sensor], LidarModel)
    return advise_views(directions, n_placements, is_lidar)


def find_flipped_pattern(
    sensor: str, setup: Setup, result: EstimationResult
) -> FlippedPattern | None:
    """Return the first checkerboard without inliers that fits far better the other way round."""
    for group, assignment in sensor_groups(sensor, setup, result):
        target = setup.placements[group.placement].target
        pattern = setup.targets[target].pattern
        has_inliers = (assignment.feature >= 0).any()
        if (
            group.kind != "pattern_corner"
            or has_inliers
            or not hasattr(pattern, "first_square_color")
        ):
            continue
        stated, free = _misfits_px(setup, result, group, pattern)
        if free < MAX_FLIPPED_MISFIT_RATIO * stated:
            return FlippedPattern(target, pattern.first_square_color, stated, free)
    return None


def _misfits_px(
    setup: Setup, result: EstimationResult, group: MeasurementGroup, pattern: Any
) -> tuple[float, float]:
    """Return the misfit of the first view with the stated and with any colour of first square."""
    T = T_sensor_target(setup, result.state, group.sensor, group.placement)
    points = transform_points(T, pattern.corners())
    camera = model_with_corrections(setup, result.state, group)
    if not isinstance(camera, CameraModel):
        raise TypeError(f"{group.sensor} is no camera, but has pattern corners")
    uv, _ = camera.project(points)
    rows = np.flatnonzero(group.keypoints["view"] == group.keypoints["view"][0])
    stated, free = (
        score_labellings(p, uv, group.keypoints, rows)[1].min()
        for p in (pattern, replace(pattern, first_square_color=None))
    )
    return stated, free
