"""Whether a target is in view of a sensor, given how wrong the pose may be."""

import numpy as np

from calib.geometry.pose_margin import angular_margin
from calib.geometry.se3 import invert_pose, so3_exp, transform_points

MIN_SQUARE_PX = 6.0
MIN_BLOB_SIZE_PX = 15.0  # geometric mean of the spread of its outline along and across


def check_lidar_visibility(lidar, target, T_sensor_target, margin, options):
    """Why a lidar cannot see a target well enough, in words; "" when it can.

    With a margin: why it cannot wherever within it the lidar may be.
    """
    centre = transform_points(T_sensor_target, target.centre)
    distance, shift = np.linalg.norm(centre), np.linalg.norm(margin[:3])
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
    reason, cosine = _check_incidence(target, T_sensor_target, margin, options)
    nearest = max(distance - shift, target.bounding_radius)
    expected = target.area * cosine / nearest**2 / lidar.azimuth_step / lidar.elevation_step
    if not reason and expected < options["min_returns"]:
        return "too few returns expected"
    return reason


def check_camera_visibility(camera, target, T_sensor_target, margin, options):
    """Why a camera cannot see what it could find of a target, in words; "" when it can.

    With a margin: why it cannot wherever within it the camera may be.
    """
    points = transform_points(T_sensor_target, target.required_image_points())
    if len(points) == 0:
        return "neither pattern nor color on the target"
    reason, _ = _check_incidence(target, T_sensor_target, margin, options)
    if reason:
        return reason
    turn = angular_margin(margin, np.linalg.norm(points.mean(0)))
    uv, valid, inside = _project_with_margin(camera, points, turn)
    if inside.mean() < (target.pattern.min_visible_share if target.pattern else 1.0):
        return "outside the image" if valid.all() else "outside what the lens sees"
    if not valid.all():
        return ""
    # A point nearer by the margin, or away from the rim of a lens, appears larger.
    larger = 1 + 2 * turn
    if target.pattern and np.linalg.norm(uv[1] - uv[0]) * larger < MIN_SQUARE_PX:
        return "squares too small"
    if target.color and np.sqrt(np.linalg.det(np.cov(uv.T))) * larger**2 < MIN_BLOB_SIZE_PX**2:
        return "too small in the image"
    return ""


def _project_with_margin(camera, points, max_turn_rad):
    """Pixels (n, 2) of points (n, 3), where there are any (n,), and whether each may be in the
    image (n,) when the camera is turned by up to `turn`, rad, about its x and y axes."""
    uv, valid = camera.project(points)
    inside = valid & camera.is_in_image(uv)
    for about in ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1)):
        if inside.all() or max_turn_rad == 0:
            break
        turned = points @ so3_exp(max_turn_rad * np.array([*about, 0.0])).T
        at, ok = camera.project(turned)
        inside |= ok & camera.is_in_image(at)
    return uv, valid, inside


def _check_incidence(target, T_sensor_target, margin, options):
    """(why a target shows a sensor too little of its face, cosine of incidence), at best: the
    sensor may stand elsewhere by the margin, which the target sees under an angle."""
    sensor = invert_pose(T_sensor_target)[:3, 3]
    facing, cosine = target.check_facing(sensor)
    shift = np.linalg.norm(margin[:3]) / np.linalg.norm(sensor - target.centre)
    slack = np.arcsin(min(1.0, shift))
    if not facing and (slack == 0 or cosine <= -np.sin(slack)):
        return "seen from behind", 0.0
    incidence = max(0.0, np.arccos(np.clip(cosine, -1, 1)) - slack)
    if incidence > np.radians(options["max_incidence_deg"]):
        return "seen too flat", np.cos(incidence)
    return "", np.cos(incidence)
