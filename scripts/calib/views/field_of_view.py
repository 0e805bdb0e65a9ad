"""Whether a target is in view of a sensor, given how wrong the pose may be."""

import numpy as np

from calib.geometry import pose_margin, se3

MIN_SQUARE_PX = 6.0
MIN_BLOB_PX = 15.0  # geometric mean of the spread of its outline along and across


def hidden_from_lidar(lidar, target, T_sensor_target, margin, options):
    """Why a lidar cannot see a target well enough, in words; "" when it can.

    With a margin: why it cannot wherever within it the lidar may be.
    """
    centre = se3.transform(T_sensor_target, target.centre)
    distance, shift = np.linalg.norm(centre), np.linalg.norm(margin[:3])
    if not lidar.range[0] - shift < distance < lidar.range[1] + shift:
        return f"at {distance:.1f} m, outside range_m"
    slack = pose_margin.spread(margin, distance) + np.arcsin(min(1.0, target.reach / distance))
    azimuth, elevation = np.arctan2(centre[1], centre[0]), np.arcsin(centre[2] / distance)
    for name, angle, limits in (
        ("azimuth", azimuth, lidar.azimuth),
        ("elevation", elevation, lidar.elevation),
    ):
        if limits and not limits[0] - slack < angle < limits[1] + slack:
            return f"outside {name}_deg"
    reason, cosine = _turned_away(target, T_sensor_target, margin, options)
    nearest = max(distance - shift, target.reach)
    expected = target.area * cosine / nearest**2 / lidar.azimuth_step / lidar.elevation_step
    if not reason and expected < options["min_returns"]:
        return "too few returns expected"
    return reason


def hidden_from_camera(camera, target, T_sensor_target, margin, options):
    """Why a camera cannot see what it could find of a target, in words; "" when it can.

    With a margin: why it cannot wherever within it the camera may be.
    """
    points = se3.transform(T_sensor_target, target.image_points())
    if len(points) == 0:
        return "neither pattern nor color on the target"
    reason, _ = _turned_away(target, T_sensor_target, margin, options)
    if reason:
        return reason
    turn = pose_margin.spread(margin, np.linalg.norm(points.mean(0)))
    uv, valid, inside = _in_image(camera, points, turn)
    if inside.mean() < (target.pattern.share if target.pattern else 1.0):
        return "outside the image" if valid.all() else "outside what the lens sees"
    if not valid.all():
        return ""
    # A point nearer by the margin, or away from the rim of a lens, appears larger.
    larger = 1 + 2 * turn
    if target.pattern and np.linalg.norm(uv[1] - uv[0]) * larger < MIN_SQUARE_PX:
        return "squares too small"
    if target.color and np.sqrt(np.linalg.det(np.cov(uv.T))) * larger**2 < MIN_BLOB_PX**2:
        return "too small in the image"
    return ""


def _in_image(camera, points, turn):
    """Pixels (n, 2) of points (n, 3), where there are any (n,), and whether each may be in the
    image (n,) when the camera is turned by up to `turn`, rad, about its x and y axes."""
    uv, valid = camera.project(points)
    inside = valid & camera.in_image(uv)
    for about in ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1)):
        if inside.all() or turn == 0:
            break
        turned = points @ se3.so3_exp(turn * np.array([*about, 0.0])).T
        at, ok = camera.project(turned)
        inside |= ok & camera.in_image(at)
    return uv, valid, inside


def _turned_away(target, T_sensor_target, margin, options):
    """(why a target shows a sensor too little of its face, cosine of incidence), at best: the
    sensor may stand elsewhere by the margin, which the target sees under an angle."""
    sensor = se3.inverse(T_sensor_target)[:3, 3]
    facing, cosine = target.faces(sensor)
    shift = np.linalg.norm(margin[:3]) / np.linalg.norm(sensor - target.centre)
    slack = np.arcsin(min(1.0, shift))
    if not facing and (slack == 0 or cosine <= -np.sin(slack)):
        return "seen from behind", 0.0
    incidence = max(0.0, np.arccos(np.clip(cosine, -1, 1)) - slack)
    if incidence > np.radians(options["max_incidence_deg"]):
        return "seen too flat", np.cos(incidence)
    return "", np.cos(incidence)
