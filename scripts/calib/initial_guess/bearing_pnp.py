"""Find poses of a camera from the directions in which it sees known points.

Directions are rotated about the camera so that their mean is along z. This works for every lens, up
to 80 degrees to all sides of the mean direction.
"""

from typing import NamedTuple

import cv2
import numpy as np

from calib.geometry.se3 import invert_pose, make_pose, rotation_between, so3_exp

MIN_BEARING_COSINE = 0.15  # between a direction and the mean direction


class _CentredBearings(NamedTuple):
    """Bearings as points (n, 2) of the plane z = 1, after the rotation turn (3, 3)."""

    uv: np.ndarray
    turn: np.ndarray


def _centre_bearings(rays: np.ndarray) -> _CentredBearings | None:
    """Rotate rays (n, 3) so that their mean is along z; None if one is too far from the mean."""
    turn = rotation_between(rays.mean(0), np.array([0.0, 0.0, 1.0]))
    ahead = rays @ turn.T
    if (ahead[:, 2] < MIN_BEARING_COSINE).any():
        return None
    return _CentredBearings(ahead[:, :2] / ahead[:, 2:], turn)


def solve_planar_pnp(rays: np.ndarray, points: np.ndarray) -> list[np.ndarray]:
    """Return the poses T_camera_target (4, 4) that see points (n, 3), m, along rays (n, 3).

    The points have one z. A plane can fit in two ways (Collins and Bartoli 2014, in OpenCV); both
    are refined.
    """
    bearings = _centre_bearings(rays)
    if bearings is None:
        return []
    lift = points[0] * [0, 0, 1]
    flat_points, identity = points - lift, np.eye(3)
    _, rotations, translations, _ = cv2.solvePnPGeneric(
        flat_points, bearings.uv, identity, None, flags=cv2.SOLVEPNP_IPPE
    )
    poses = []
    for w, t in zip(rotations, translations, strict=True):
        w, t = cv2.solvePnPRefineLM(flat_points, bearings.uv, identity, None, w, t)
        T = make_pose(bearings.turn.T) @ make_pose(so3_exp(w[:, 0]), t[:, 0])
        poses.append(T @ make_pose(t=-lift))
    return poses


def solve_p3p(rays: np.ndarray, points: np.ndarray) -> list[np.ndarray]:
    """Return the poses T_robot_camera (4, 4) that see points (3, 3), robot frame, along rays."""
    bearings = _centre_bearings(rays)
    if bearings is None:
        return []
    _, rotations, translations = cv2.solveP3P(
        points, bearings.uv, np.eye(3), None, flags=cv2.SOLVEPNP_AP3P
    )
    turned = [
        make_pose(so3_exp(w[:, 0]), t[:, 0]) for w, t in zip(rotations, translations, strict=True)
    ]
    return [invert_pose(T) @ make_pose(bearings.turn) for T in turned]
