"""Find the part of a scan or image around a target that is kept."""

import numpy as np

from calib.geometry.pose_margin import angular_margin
from calib.geometry.se3 import transform_points
from calib.sensors.camera.camera_model import CameraModel
from calib.targets.target_shapes import TargetShape

# Directions in the camera frame in which a point is shifted by the margin.
MARGIN_DIRECTIONS = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])


def pixel_margin(camera: CameraModel, p_camera: np.ndarray, margin: np.ndarray) -> float:
    """Return by how many pixels a point p_camera (3,), m, may appear beside its prediction.

    margin: (6,) m and rad. Near the rim of the lens only pixels that exist count; if there are
    none, the result is the whole image.
    """
    distance = float(np.linalg.norm(p_camera))
    shift = angular_margin(margin, distance) * distance
    uv, is_valid = camera.project(p_camera + shift * MARGIN_DIRECTIONS)
    if not (is_valid[0] and is_valid[1:].any()):
        return float(max(camera.size_px))
    offset = np.linalg.norm(uv[1:] - uv[0], axis=1)[is_valid[1:]].max()
    return float(min(offset, max(camera.size_px)))


def is_in_view_cone(
    points: np.ndarray, target: TargetShape, T_sensor_target: np.ndarray, margin: np.ndarray
) -> np.ndarray:
    """Return which points (n, 3), sensor frame, are in the angular window around the target.

    The window has any range. margin: (6,) m and rad, by which T_sensor_target (4, 4) may be wrong.
    """
    centre = transform_points(T_sensor_target, target.centre)
    distance = float(np.linalg.norm(centre))
    radius_rad = np.arcsin(min(1.0, target.bounding_radius / distance))
    half = radius_rad + angular_margin(margin, distance)
    along = points @ (centre / distance)
    return along > np.cos(min(half, np.pi)) * np.linalg.norm(points, axis=1)


def find_image_region(
    camera: CameraModel, target: TargetShape, T_sensor_target: np.ndarray, margin: np.ndarray
) -> tuple[int, int, int, int]:
    """Return columns and rows (u0, u1, v0, v1) of the image around a target, with its margin."""
    points = transform_points(T_sensor_target, target.outline_points())
    uv, is_valid = camera.project(points)
    grow = pixel_margin(camera, points.mean(0), margin)
    width, height = camera.size_px
    if not is_valid.all():
        return 0, width, 0, height
    low, high = np.floor(uv.min(0) - grow), np.ceil(uv.max(0) + grow) + 1
    low = np.clip(low, 0, [width, height]).astype(int)
    high = np.clip(high, 0, [width, height]).astype(int)
    return low[0], high[0], low[1], high[1]
