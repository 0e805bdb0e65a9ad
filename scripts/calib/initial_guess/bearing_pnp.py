"""Poses of a camera from the directions in which it sees known points.

Directions are turned about the camera so that their mean lies along z: every lens will do, up to
80 degrees to all sides of what it sees at once.
"""

import cv2
import numpy as np

from calib.geometry.se3 import invert_pose, make_pose, rotation_between, so3_exp

MIN_BEARING_COSINE = 0.15  # least cosine between a direction and the mean of all


def solve_planar_pnp(rays, points):
    """[T_camera_target (4, 4)] of points (n, 3), in a plane of constant z, along rays (n, 3).

    A plane may fit in two ways (Collins and Bartoli 2014, in OpenCV); both are refined.
    """
    turn = rotation_between(rays.mean(0), np.array([0.0, 0.0, 1.0]))
    ahead = rays @ turn.T
    if (ahead[:, 2] < MIN_BEARING_COSINE).any():
        return []
    flat = ahead[:, :2] / ahead[:, 2:]
    lift = points[0] * [0, 0, 1]
    found = cv2.solvePnPGeneric(points - lift, flat, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    out = []
    for w, t in zip(found[1], found[2], strict=True):
        w, t = cv2.solvePnPRefineLM(points - lift, flat, np.eye(3), None, w, t)
        T = make_pose(turn.T) @ make_pose(so3_exp(w[:, 0]), t[:, 0])
        out.append(T @ make_pose(t=-lift))
    return out


def solve_p3p(rays, points):
    """[T_robot_camera (4, 4)] that see points (3, 3), robot frame, along rays (3, 3)."""
    turn = rotation_between(rays.mean(0), np.array([0.0, 0.0, 1.0]))
    ahead = rays @ turn.T
    if (ahead[:, 2] < MIN_BEARING_COSINE).any():
        return []
    flat = ahead[:, :2] / ahead[:, 2:]
    _, ws, ts = cv2.solveP3P(points, flat, np.eye(3), None, flags=cv2.SOLVEPNP_AP3P)
    turned = [make_pose(so3_exp(w[:, 0]), t[:, 0]) for w, t in zip(ws, ts, strict=True)]
    return [invert_pose(T) @ make_pose(turn) for T in turned]
