"""Where scan lines leave a flat target: halfway between the last beam on it and the next."""

import numpy as np

from calib.geometry.polygon import signed_polygon_distance
from calib.geometry.se3 import invert_pose, so3_exp, transform_points

MAX_OUTSIDE_OUTLINE_M = (
    0.05  # a return this far outside the outline may still be one of the board's own
)


def find_outline_crossings(target, T_sensor_target, points, ring, lidar, gate_m):
    """Unit rays (m, 3), sensor frame, of the outline crossings in one scan, and their rings (m,).

    points (n, 3) and ring (n,) are all returns of the window. A beam is on the board when it ends
    within gate_m of its plane and over its outline. Where the next beam of the ring gave no return
    the crossing is taken half a step beyond the last one.
    """
    q = transform_points(invert_pose(T_sensor_target), points)
    over = signed_polygon_distance(target.vertices, q[:, :2]) < MAX_OUTSIDE_OUTLINE_M
    on = over & (np.abs(q[:, 2]) < gate_m)
    rays, rings = [], []
    for r in np.unique(ring[on & (ring >= 0)]):
        line = np.flatnonzero(ring == r)
        azimuth = np.arctan2(points[line, 1], points[line, 0])
        middle = np.arctan2(*points[on & (ring == r)].mean(0)[1::-1])
        line = line[np.argsort((azimuth - middle + np.pi) % (2 * np.pi))]
        for side in (1, -1):
            ray = _crossing_ray(points[line], on[line], side, lidar.azimuth_step)
            if ray is not None:
                rays.append(ray)
                rings.append(r)
    return np.reshape(rays, (-1, 3)), np.array(rings, int)


def _crossing_ray(points, is_on_target, side, step):
    """The ray halfway past the outermost beam on the board, to one side of a scan line in order."""
    last = np.flatnonzero(is_on_target)[-1 if side > 0 else 0]
    here = points[last] / np.linalg.norm(points[last])
    after = last + side
    beyond = _rotate_about_z(here, side * step)
    if 0 <= after < len(points):
        there = points[after] / np.linalg.norm(points[after])
        if np.arccos(np.clip(here @ there, -1, 1)) < 1.5 * step:
            beyond = there
    ray = here + beyond
    return ray / np.linalg.norm(ray)


def _rotate_about_z(ray, angle):
    """A ray (3,) turned about z by an angle, rad."""
    return so3_exp(np.array([0.0, 0.0, angle])) @ ray
