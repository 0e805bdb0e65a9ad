"""Views that a sensor could be shown next: a target elsewhere and tilted, and that in words.

All is said as the sensor sees it: directions by the parts of an image or the azimuth of a lidar,
attitudes by the sensor's own upright, for nobody knows how a sensor hangs on the robot.
"""

from typing import NamedTuple

import numpy as np

from calib.geometry.se3 import invert_pose, make_pose, so3_exp, transform_points
from calib.sensors.camera.camera_model import CameraModel

TILT_DEG = 40.0
NEAR_DISTANCE_FACTOR, FAR_DISTANCE_FACTOR = (
    0.75,
    1.25,
)  # of the nearest and the farthest that was recorded
AZIMUTHS_DEG = (0, 45, 90, 135, 180, -135, -90, -45)
IMAGE_OFFSET_SHARE = 0.3  # of the image's size, from its middle
HEIGHT_MARGIN_M = 0.3  # beyond those that targets had, at which nobody can hold one
IMAGE_COLUMN_NAMES = {-1: "left", 0: "", 1: "right"}
IMAGE_ROW_NAMES = {-1: "upper", 0: "", 1: "lower"}


class ViewCandidate(NamedTuple):
    """T_sensor_target (4, 4), and where and how the target then is, in words."""

    T_sensor_target: np.ndarray
    description: str


def list_view_candidates(target, model, T_sensor_targets, heights, T_robot_sensor):
    """Proposals for a target that a Camera or rig.Lidar saw at T_sensor_targets (k, 4, 4).

    heights (2,): lowest and highest, m, along z of the robot's body, that targets were at; none is
    proposed far beyond. A target without an axis is taken to be flat, as a board is.
    """
    attitudes = _cylinder_orientations if target.symmetry_axes else _board_orientations
    low, high = heights[0] - HEIGHT_MARGIN_M, heights[1] + HEIGHT_MARGIN_M
    out = []
    for ray, where in _candidate_rays(model, T_sensor_targets, target):
        for distance in _candidate_distances(T_sensor_targets, target):
            at = ray * distance
            if not low < transform_points(T_robot_sensor, at)[2] < high:
                continue
            for R, how in attitudes(_viewing_axes(model, ray), T_sensor_targets, target):
                T = make_pose(R, at - R @ target.centre)
                out.append(ViewCandidate(T, f"{distance:.1f} m away, {where}, {how}"))
    return out


def _candidate_distances(T, target):
    """Distances, m, to tenths: nearer than recorded, and farther."""
    found = np.linalg.norm(transform_points(T, target.centre), axis=1)
    chosen = NEAR_DISTANCE_FACTOR * found.min(), FAR_DISTANCE_FACTOR * found.max()
    return sorted({round(float(d), 1) for d in chosen} - {0.0})


def _candidate_rays(model, T, target):
    """[(unit ray (3,), in words)]: parts of an image, or azimuths of a lidar at the elevation that
    the target was at."""
    if isinstance(model, CameraModel):
        size = np.array(model.size_px)
        out = []
        for row, level in IMAGE_ROW_NAMES.items():
            for column, side in IMAGE_COLUMN_NAMES.items():
                ray, seen = model.unproject(
                    ((0.5 + IMAGE_OFFSET_SHARE * np.array([column, row])) * size)[None]
                )
                part = " ".join(w for w in (level, side) if w)
                words = f"in the {part} part of the image" if part else "in the middle of the image"
                if seen[0]:
                    out.append((ray[0] / np.linalg.norm(ray[0]), words))
        return out
    p = transform_points(T, target.centre)
    elevation = np.median(np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1])))
    level, rise = np.cos(elevation), np.sin(elevation)
    azimuths = np.radians(AZIMUTHS_DEG)
    rays = [np.array([level * np.cos(a), level * np.sin(a), rise]) for a in azimuths]
    return [(r, f"at azimuth {d}° of the lidar") for r, d in zip(rays, AZIMUTHS_DEG, strict=True)]


def _viewing_axes(model, ray):
    """(right, up, toward) unit vectors (3,) at the end of a ray, as the sensor sees it."""
    upright = np.array([0.0, -1, 0] if isinstance(model, CameraModel) else [0.0, 0, 1])
    right = np.cross(ray, upright)
    right /= np.linalg.norm(right)
    return right, np.cross(right, ray), -ray


def _board_orientations(seen, T_sensor_targets, target):
    """[(R (3, 3), in words)] of a flat target, its edges turned in its plane as recorded."""
    right, up, toward = seen
    x = T_sensor_targets[0][:3, 0]
    x = x - (x @ toward) * toward
    x = right if np.linalg.norm(x) < 0.1 else x / np.linalg.norm(x)
    facing = np.column_stack([x, np.cross(toward, x), toward])
    tilt = np.radians(TILT_DEG)
    turns = ((up, 1, "right"), (up, -1, "left"), (right, -1, "up"), (right, 1, "down"))
    out = [(facing, "facing the sensor")]
    for axis, sign, side in turns:
        R = so3_exp(sign * tilt * axis) @ facing
        out.append((R, f"its face turned {TILT_DEG:.0f}° {side} as the sensor sees it"))
    return out


def _cylinder_orientations(seen, T_sensor_targets, target):
    """[(R (3, 3), in words)] of a cylinder along x, the side that was seen towards the sensor."""
    right, up, toward = seen
    _, y, z = invert_pose(T_sensor_targets[0])[:3, 3]
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
        (_cylinder_rotation(a / np.linalg.norm(a), toward, np.arctan2(z, y)), words)
        for a, words in along
    ]


def _cylinder_rotation(axis, toward, angle):
    """R (3, 3) of a cylinder along an axis, turned about it so that it shows the sensor what lies
    at an angle about its x."""
    side = toward - (toward @ axis) * axis
    side /= np.linalg.norm(side)
    y = np.cos(angle) * side - np.sin(angle) * np.cross(axis, side)
    return np.column_stack([axis, y, np.cross(axis, y)])
