"""Where scan lines leave a flat target: halfway between the last beam on it and the next."""

import numpy as np

from calib.geometry import polygon, se3

REACH_M = 0.05  # a return this far outside the outline may still be one of the board's own


def crossings(target, T_sensor_target, points, ring, lidar, gate_m):
    """Unit rays (m, 3), sensor frame, of the outline crossings in one scan, and their rings (m,).

    points (n, 3) and ring (n,) are all returns of the window. A beam is on the board when it ends
    within gate_m of its plane and over its outline. Where the next beam of the ring gave no return
    the crossing is taken half a step beyond the last one.
    """
    q = se3.transform(se3.inverse(T_sensor_target), points)
    over = polygon.signed_distance(target.vertices, q[:, :2]) < REACH_M
    on = over & (np.abs(q[:, 2]) < gate_m)
    rays, rings = [], []
    for r in np.unique(ring[on & (ring >= 0)]):
        line = np.flatnonzero(ring == r)
        azimuth = np.arctan2(points[line, 1], points[line, 0])
        middle = np.arctan2(*points[on & (ring == r)].mean(0)[1::-1])
        line = line[np.argsort((azimuth - middle + np.pi) % (2 * np.pi))]
        for side in (1, -1):
            ray = _crossing(points[line], on[line], side, lidar.azimuth_step)
            if ray is not None:
                rays.append(ray)
                rings.append(r)
    return np.reshape(rays, (-1, 3)), np.array(rings, int)


def _crossing(points, on, side, step):
    """The ray halfway past the outermost beam on the board, to one side of a scan line in order."""
    last = np.flatnonzero(on)[-1 if side > 0 else 0]
    here = points[last] / np.linalg.norm(points[last])
    after = last + side
    beyond = _turned(here, side * step)
    if 0 <= after < len(points):
        there = points[after] / np.linalg.norm(points[after])
        if np.arccos(np.clip(here @ there, -1, 1)) < 1.5 * step:
            beyond = there
    ray = here + beyond
    return ray / np.linalg.norm(ray)


def _turned(ray, angle):
    """A ray (3,) turned about z by an angle, rad."""
    return se3.so3_exp(np.array([0.0, 0.0, angle])) @ ray
