"""Which frames may show a target, and the part of each around it.

All of it rests on a guess of the sensor's pose, so every window and limit grows by `margin` (6,):
the twist by which the guess may be wrong, m and rad. What is in view from anywhere within it is
then kept, wherever within it the guess lies; a margin of zero decides at the pose itself.
"""

import numpy as np

from calib import geometry

MIN_SQUARE_PX = 6.0
MIN_BLOB_PX = 15.0  # geometric mean of the spread of its outline along and across


def spread(margin, distance):
    """Angle, rad, by which a point at distance, m, may appear beside its prediction."""
    return np.linalg.norm(margin[3:]) / np.sqrt(3) * np.sqrt(2) + margin[:3].max() / distance


def hidden_from_lidar(lidar, target, T_sensor_target, margin, options):
    """Why a lidar cannot see a target well enough, in words; "" when it can.

    With a margin: why it cannot wherever within it the lidar may be.
    """
    centre = geometry.transform(T_sensor_target, target.centre)
    distance, shift = np.linalg.norm(centre), np.linalg.norm(margin[:3])
    if not lidar.range[0] - shift < distance < lidar.range[1] + shift:
        return f"at {distance:.1f} m, outside range_m"
    slack = spread(margin, distance) + np.arcsin(min(1.0, target.reach / distance))
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
    points = geometry.transform(T_sensor_target, target.image_points())
    if len(points) == 0:
        return "neither pattern nor color on the target"
    reason, _ = _turned_away(target, T_sensor_target, margin, options)
    if reason:
        return reason
    turn = spread(margin, np.linalg.norm(points.mean(0)))
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
        turned = points @ geometry.so3_exp(turn * np.array([*about, 0.0])).T
        at, ok = camera.project(turned)
        inside |= ok & camera.in_image(at)
    return uv, valid, inside


def _turned_away(target, T_sensor_target, margin, options):
    """(why a target shows a sensor too little of its face, cosine of incidence), at best: the
    sensor may stand elsewhere by the margin, which the target sees under an angle."""
    sensor = geometry.inverse(T_sensor_target)[:3, 3]
    facing, cosine = target.faces(sensor)
    shift = np.linalg.norm(margin[:3]) / np.linalg.norm(sensor - target.centre)
    slack = np.arcsin(min(1.0, shift))
    if not facing and (slack == 0 or cosine <= -np.sin(slack)):
        return "seen from behind", 0.0
    incidence = max(0.0, np.arccos(np.clip(cosine, -1, 1)) - slack)
    if incidence > np.radians(options["max_incidence_deg"]):
        return "seen too flat", np.cos(incidence)
    return "", np.cos(incidence)


def margin_px(camera, p_camera, margin):
    """Pixels by which a point p_camera (3,), m, may appear beside its prediction.

    Near the rim of what the lens sees only the pixels that exist count; with none, the whole image.
    """
    distance = np.linalg.norm(p_camera)
    aside = spread(margin, distance) * distance
    around = p_camera + aside * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    uv, valid = camera.project(around)
    if not (valid[0] and valid[1:].any()):
        return float(max(camera.size))
    beside = np.linalg.norm(uv[1:] - uv[0], axis=1)[valid[1:]].max()
    return float(min(beside, max(camera.size)))


def cone(points, target, T_sensor_target, margin):
    """Which points (n, 3), sensor frame, lie in the angular window around the target, any range."""
    centre = geometry.transform(T_sensor_target, target.centre)
    distance = np.linalg.norm(centre)
    half = np.arcsin(min(1.0, target.reach / distance)) + spread(margin, distance)
    along = points @ (centre / distance)
    return along > np.cos(min(half, np.pi)) * np.linalg.norm(points, axis=1)


def region(camera, target, T_sensor_target, margin):
    """Columns and rows (u0, u1, v0, v1) of the image around a target, its margin included."""
    points = geometry.transform(T_sensor_target, target.outline_points())
    uv, valid = camera.project(points)
    grow = margin_px(camera, points.mean(0), margin)
    width, height = camera.size
    if not valid.all():
        return 0, width, 0, height
    low, high = np.floor(uv.min(0) - grow), np.ceil(uv.max(0) + grow) + 1
    low = np.clip(low, 0, [width, height]).astype(int)
    high = np.clip(high, 0, [width, height]).astype(int)
    return low[0], high[0], low[1], high[1]


def new_poses(T, numbers, options):
    """Of the placements `numbers` (k,) those that are new, the most different first; T (n, 4, 4)
    of all placements, in the robot frame: no guess of a sensor has a part in it."""
    numbers = np.asarray(numbers, int)
    least = options["min_distance_m"], np.radians(options["min_angle_deg"])
    return numbers[most_different(T[numbers], *least, len(numbers))]


def most_different(T, min_distance, min_angle, most):
    """Indices of at most `most` poses T (n, 4, 4), each new against all others chosen.

    Farthest first: the next is the one whose nearest chosen pose is farthest, with distances in
    units of min_distance, m, and min_angle, rad; ties go to the earlier. What is left over is
    nearer than one unit to a chosen one, or one too many.
    """
    if len(T) == 0:
        return np.zeros(0, int)
    chosen, nearest = [], np.full(len(T), np.inf)
    while len(chosen) < most and nearest.max() >= 1:
        chosen.append(int(nearest.argmax()))
        away = geometry.inverse(T[chosen[-1]]) @ T
        shift = np.linalg.norm(T[:, :3, 3] - T[chosen[-1], :3, 3], axis=1)
        # A threshold of zero makes every pose new.
        far = np.maximum(
            shift / max(min_distance, 1e-9), geometry.angle(away) / max(min_angle, 1e-9)
        )
        nearest = np.minimum(nearest, far)
        nearest[chosen] = -1
    return np.array(chosen)


def evenly(n, most):
    """At most `most` of the indices 0 .. n-1, evenly spread, ends included."""
    if n <= most:
        return np.arange(n)
    return np.unique(np.round(np.linspace(0, n - 1, most)).astype(int))
