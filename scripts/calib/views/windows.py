"""The part of a scan or image around a target that is kept."""

import numpy as np

from calib.geometry.pose_margin import angular_margin
from calib.geometry.se3 import transform_points


def pixel_margin(camera, p_camera, margin):
    """Pixels by which a point p_camera (3,), m, may appear beside its prediction.

    Near the rim of what the lens sees only the pixels that exist count; with none, the whole image.
    """
    distance = np.linalg.norm(p_camera)
    aside = angular_margin(margin, distance) * distance
    around = p_camera + aside * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    uv, valid = camera.project(around)
    if not (valid[0] and valid[1:].any()):
        return float(max(camera.size))
    beside = np.linalg.norm(uv[1:] - uv[0], axis=1)[valid[1:]].max()
    return float(min(beside, max(camera.size_px)))


def is_in_view_cone(points, target, T_sensor_target, margin):
    """Which points (n, 3), sensor frame, lie in the angular window around the target, any range."""
    centre = transform_points(T_sensor_target, target.centre)
    distance = np.linalg.norm(centre)
    half = np.arcsin(min(1.0, target.bounding_radius / distance)) + angular_margin(margin, distance)
    along = points @ (centre / distance)
    return along > np.cos(min(half, np.pi)) * np.linalg.norm(points, axis=1)


def find_image_region(camera, target, T_sensor_target, margin):
    """Columns and rows (u0, u1, v0, v1) of the image around a target, its margin included."""
    points = transform_points(T_sensor_target, target.outline_points())
    uv, valid = camera.project(points)
    grow = pixel_margin(camera, points.mean(0), margin)
    width, height = camera.size_px
    if not valid.all():
        return 0, width, 0, height
    low, high = np.floor(uv.min(0) - grow), np.ceil(uv.max(0) + grow) + 1
    low = np.clip(low, 0, [width, height]).astype(int)
    high = np.clip(high, 0, [width, height]).astype(int)
    return low[0], high[0], low[1], high[1]
