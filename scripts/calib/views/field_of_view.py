"""Decide whether a sensor at an uncertain pose sees a target well enough."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from calib.geometry.pose_margin import angular_margin
from calib.geometry.se3 import invert_pose, so3_exp, transform_points
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.target_shapes import TargetShape

MIN_SQUARE_PX = 6.0
MIN_BLOB_SIZE_PX = 15.0  # geometric mean of the spread of the outline along and across
# Turns about x and y, in units of the margin, at which the image is checked.
MARGIN_TURNS = ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1))


class VisibilityCheck(Protocol):
    """Why a sensor does not see a target well enough, in words; "" if it does."""

    def __call__(
        self,
        model: Any,
        target: TargetShape,
        T_sensor_target: np.ndarray,
        margin: np.ndarray,
        options: dict[str, Any],
        /,
    ) -> str: ...


@dataclass(frozen=True)
class PosedSensor:
    """A sensor at an assumed pose.

    model: argument of check_visibility. T_robot_sensor: (4, 4). margin: (6,) m and rad, by which
    that pose may be wrong; a target counts as visible if it may be visible within the margin.
    """

    model: Any
    check_visibility: VisibilityCheck
    T_robot_sensor: np.ndarray
    margin: np.ndarray

    def T_sensor_target(self, T_robot_target: np.ndarray) -> np.ndarray:
        """Return poses (..., 4, 4) of targets in the sensor frame."""
        return invert_pose(self.T_robot_sensor) @ T_robot_target

    def reason_against(
        self, target: TargetShape, T_robot_target: np.ndarray, options: dict[str, Any]
    ) -> str:
        """Return why the target at a pose (4, 4) is not visible, "" if it is. options: `crop`."""
        T_sensor_target = self.T_sensor_target(T_robot_target)
        return self.check_visibility(self.model, target, T_sensor_target, self.margin, options)


def check_lidar_visibility(
    lidar: LidarModel,
    target: TargetShape,
    T_sensor_target: np.ndarray,
    margin: np.ndarray,
    options: dict[str, Any],
) -> str:
    """Return why a lidar cannot see a target well enough, in words; "" if it can.

    T_sensor_target: (4, 4). margin: (6,) m and rad; the reason holds for every pose within it.
    options: min_returns and max_incidence_deg.
    """
    centre = transform_points(T_sensor_target, target.centre)
    distance, shift = float(np.linalg.norm(centre)), float(np.linalg.norm(margin[:3]))
    if not lidar.range_limits[0] - shift < distance < lidar.range_limits[1] + shift:
        return f"at {distance:.1f} m, outside range_m"
    slack = angular_margin(margin, distance) + np.arcsin(
        min(1.0, target.bounding_radius / distance)
    )
    azimuth, elevation = np.arctan2(centre[1], centre[0]), np.arcsin(centre[2] / distance)
    for name, angle, limits in (
        ("azimuth", azimuth, lidar.azimuth_limits),
        ("elevation", elevation, lidar.elevation_limits),
    ):
        if limits and not limits[0] - slack < angle < limits[1] + slack:
            return f"outside {name}_deg"
    incidence = _check_incidence(target, T_sensor_target, margin, options)
    nearest = max(distance - shift, target.bounding_radius)
    expected = (
        target.area * incidence.cosine / nearest**2 / lidar.azimuth_step / lidar.elevation_step
    )
    if not incidence.reason and expected < options["min_returns"]:
        return "too few returns expected"
    return incidence.reason


def check_camera_can_find(target: TargetShape) -> str:
    """Return why a camera cannot find a target wherever it is, in words; "" if it can."""
    has_points = len(target.required_image_points()) > 0
    return "" if has_points else "neither pattern nor color on the target"


def check_camera_visibility(
    camera: CameraModel,
    target: TargetShape,
    T_sensor_target: np.ndarray,
    margin: np.ndarray,
    options: dict[str, Any],
) -> str:
    """Return why a camera cannot see the pattern or colour of a target, in words; "" if it can.

    T_sensor_target: (4, 4). margin: (6,) m and rad; the reason holds for every pose within it.
    options: max_incidence_deg.
    """
    if not_found := check_camera_can_find(target):
        return not_found
    points = transform_points(T_sensor_target, target.required_image_points())
    incidence = _check_incidence(target, T_sensor_target, margin, options)
    if incidence.reason:
        return incidence.reason
    turn = float(angular_margin(margin, float(np.linalg.norm(points.mean(0)))))
    uv, is_valid, is_inside = _project_with_margin(camera, points, turn)
    if is_inside.mean() < (target.pattern.min_visible_share if target.pattern else 1.0):
        return "outside the image" if is_valid.all() else "outside what the lens sees"
    if not is_valid.all():
        return ""
    # A point nearer by the margin, or away from the rim of a lens, appears larger.
    magnification = 1 + 2 * turn
    if target.pattern and np.linalg.norm(uv[1] - uv[0]) * magnification < MIN_SQUARE_PX:
        return "squares too small"
    size_px = np.sqrt(np.linalg.det(np.cov(uv.T))) if target.color else np.inf
    if size_px * magnification**2 < MIN_BLOB_SIZE_PX**2:
        return "too small in the image"
    return ""


def _project_with_margin(
    camera: CameraModel, points: np.ndarray, max_turn_rad: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project points (n, 3), m, and check whether they may be in the image.

    Returns pixels (n, 2), whether each is valid (n,), and whether it may be in the image (n,) if
    the camera is turned by up to max_turn_rad about its x and y axes.
    """
    uv, is_valid = camera.project(points)
    is_inside = is_valid & camera.is_in_image(uv)
    for turn in MARGIN_TURNS:
        if is_inside.all() or max_turn_rad == 0:
            break
        turned = points @ so3_exp(max_turn_rad * np.array([*turn, 0.0])).T
        turned_uv, is_turned_valid = camera.project(turned)
        is_inside |= is_turned_valid & camera.is_in_image(turned_uv)
    return uv, is_valid, is_inside


class _Incidence(NamedTuple):
    """Why a target shows too little of its face ("" if enough), and the cosine of incidence."""

    reason: str
    cosine: float


def _check_incidence(
    target: TargetShape, T_sensor_target: np.ndarray, margin: np.ndarray, options: dict[str, Any]
) -> _Incidence:
    """Check the angle of incidence at the best pose of the sensor within the margin."""
    sensor = invert_pose(T_sensor_target)[:3, 3]
    is_facing, cosine = target.check_facing(sensor)
    shift = float(np.linalg.norm(margin[:3]) / np.linalg.norm(sensor - target.centre))
    slack = np.arcsin(min(1.0, shift))
    if not is_facing and (slack == 0 or cosine <= -np.sin(slack)):
        return _Incidence("seen from behind", 0.0)
    angle = max(0.0, float(np.arccos(np.clip(cosine, -1, 1)) - slack))
    is_too_flat = angle > np.radians(options["max_incidence_deg"])
    return _Incidence("seen too flat" if is_too_flat else "", np.cos(angle))
