"""Candidates for the next view of a target: other positions and tilts, and their description.

Descriptions are relative to the sensor, because its attitude on the robot is arbitrary: parts of
the image, or azimuths of a lidar; tilts relative to the upright direction of the sensor frame.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.geometry.se3 import invert_pose, make_pose, so3_exp, transform_points
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel

TILT_DEG = 40.0
NEAR_DISTANCE_FACTOR = 0.75  # of the smallest recorded distance
FAR_DISTANCE_FACTOR = 1.25  # of the largest recorded distance
AZIMUTHS_DEG = (0, 45, 90, 135, 180, -135, -90, -45)
IMAGE_OFFSET_SHARE = 0.3  # of the image size, from the centre
HEIGHT_MARGIN_M = 0.3  # beyond the recorded heights; targets cannot be held farther away
IMAGE_COLUMN_NAMES = {-1: "left", 0: "", 1: "right"}
IMAGE_ROW_NAMES = {-1: "upper", 0: "", 1: "lower"}


class ViewCandidate(NamedTuple):
    """A target pose T_sensor_target (4, 4), and its description relative to the sensor."""

    T_sensor_target: np.ndarray
    description: str


class _Ray(NamedTuple):
    """A unit vector (3,) from the sensor, and where it points."""

    direction: np.ndarray
    description: str


class _Orientation(NamedTuple):
    """R_sensor_target (3, 3), and its description."""

    rotation: np.ndarray
    description: str


class _ViewingAxes(NamedTuple):
    """Unit vectors (3,) at a target, as the sensor sees it."""

    right: np.ndarray
    up: np.ndarray
    toward: np.ndarray


def list_view_candidates(
    target: Any,
    model: CameraModel | LidarModel,
    T_sensor_targets: np.ndarray,
    heights_m: Sequence[float],
    T_robot_sensor: np.ndarray,
) -> list[ViewCandidate]:
    """Return candidates for a target that a sensor saw at T_sensor_targets (k, 4, 4).

    heights_m: lowest and highest z, robot frame, of recorded targets; no candidate is far beyond. A
    target without an axis is taken to be flat.
    """
    orientations: Callable[[_ViewingAxes, np.ndarray], list[_Orientation]] = (
        _cylinder_orientations if target.symmetry_axes else _board_orientations
    )
    low, high = heights_m[0] - HEIGHT_MARGIN_M, heights_m[1] + HEIGHT_MARGIN_M
    centres = transform_points(T_sensor_targets, target.centre)
    out = []
    for ray in _candidate_rays(model, centres):
        for distance in _candidate_distances_m(centres):
            centre = ray.direction * distance
            if not low < transform_points(T_robot_sensor, centre)[2] < high:
                continue
            for R, tilt in orientations(_viewing_axes(model, ray.direction), T_sensor_targets[0]):
                T = make_pose(R, centre - R @ target.centre)
                text = f"{distance:.1f} m away, {ray.description}, {tilt}"
                out.append(ViewCandidate(T, text))
    return out


def _candidate_distances_m(centres: np.ndarray) -> list[float]:
    """Return a distance below and one above those recorded, rounded to 0.1 m."""
    recorded = np.linalg.norm(centres, axis=1)
    chosen = NEAR_DISTANCE_FACTOR * recorded.min(), FAR_DISTANCE_FACTOR * recorded.max()
    return sorted({round(float(d), 1) for d in chosen} - {0.0})


def _candidate_rays(model: CameraModel | LidarModel, centres: np.ndarray) -> list[_Ray]:
    """Return rays to parts of the image, or by azimuth at the elevation of recorded targets.

    centres: (k, 3) of recorded targets, sensor frame.
    """
    return _image_rays(model) if isinstance(model, CameraModel) else _azimuth_rays(centres)


def _image_rays(camera: CameraModel) -> list[_Ray]:
    size, out = np.array(camera.size_px), []
    for row, level in IMAGE_ROW_NAMES.items():
        for column, side in IMAGE_COLUMN_NAMES.items():
            pixel = (0.5 + IMAGE_OFFSET_SHARE * np.array([column, row])) * size
            ray, is_valid = camera.unproject(pixel[None])
            part = " ".join(word for word in (level, side) if word)
            text = f"in the {part} part of the image" if part else "in the middle of the image"
            if is_valid[0]:
                out.append(_Ray(ray[0] / np.linalg.norm(ray[0]), text))
    return out


def _azimuth_rays(centres: np.ndarray) -> list[_Ray]:
    elevation = np.median(np.arctan2(centres[:, 2], np.hypot(centres[:, 0], centres[:, 1])))
    level, rise = np.cos(elevation), np.sin(elevation)
    return [
        _Ray(
            np.array([level * np.cos(azimuth), level * np.sin(azimuth), rise]),
            f"at azimuth {degrees}° of the lidar",
        )
        for azimuth, degrees in zip(np.radians(AZIMUTHS_DEG), AZIMUTHS_DEG, strict=True)
    ]


def _viewing_axes(model: CameraModel | LidarModel, ray: np.ndarray) -> _ViewingAxes:
    upright = np.array([0.0, -1, 0] if isinstance(model, CameraModel) else [0.0, 0, 1])
    right = np.cross(ray, upright)
    right /= np.linalg.norm(right)
    return _ViewingAxes(right, np.cross(right, ray), -ray)


def _board_orientations(axes: _ViewingAxes, T_recorded: np.ndarray) -> list[_Orientation]:
    """Return orientations of a flat target. T_recorded: (4, 4), for the direction of its edges."""
    right, up, toward = axes
    x = T_recorded[:3, 0]
    x = x - (x @ toward) * toward
    x = right if np.linalg.norm(x) < 0.1 else x / np.linalg.norm(x)
    facing = np.column_stack([x, np.cross(toward, x), toward])
    tilt = np.radians(TILT_DEG)
    turns = ((up, 1, "right"), (up, -1, "left"), (right, -1, "up"), (right, 1, "down"))
    out = [_Orientation(facing, "facing the sensor")]
    for axis, sign, side in turns:
        R = so3_exp(sign * tilt * axis) @ facing
        text = f"its face turned {TILT_DEG:.0f}° {side} as the sensor sees it"
        out.append(_Orientation(R, text))
    return out


def _cylinder_orientations(axes: _ViewingAxes, T_recorded: np.ndarray) -> list[_Orientation]:
    """Return orientations of a cylinder along x, with the recorded side towards the sensor."""
    right, up, toward = axes
    _, y, z = invert_pose(T_recorded)[:3, 3]
    tilt = np.radians(TILT_DEG)
    along = (
        (up, "upright"),
        (right, "level, across the view"),
        (up + right, "leaning 45° to the right"),
        (up - right, "leaning 45° to the left"),
        (np.cos(tilt) * up + np.sin(tilt) * toward, f"its top {TILT_DEG:.0f}° towards the sensor"),
        (
            np.cos(tilt) * right + np.sin(tilt) * toward,
            f"level, one end {TILT_DEG:.0f}° towards the sensor",
        ),
    )
    return [
        _Orientation(_cylinder_rotation(a / np.linalg.norm(a), toward, np.arctan2(z, y)), text)
        for a, text in along
    ]


def _cylinder_rotation(axis: np.ndarray, toward: np.ndarray, angle: float) -> np.ndarray:
    """Return R (3, 3) of a cylinder along an axis; its side at `angle` about x faces the sensor."""
    side = toward - (toward @ axis) * axis
    side /= np.linalg.norm(side)
    y = np.cos(angle) * side - np.sin(angle) * np.cross(axis, side)
    return np.column_stack([axis, y, np.cross(axis, y)])
