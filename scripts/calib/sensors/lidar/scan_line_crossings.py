"""Where scan lines leave a flat target: halfway between the last beam on it and the next."""

from typing import NamedTuple

import numpy as np

from calib.geometry.polygon import signed_polygon_distance
from calib.geometry.se3 import invert_pose, so3_exp, transform_points
from calib.targets.board import Board

MAX_OUTSIDE_OUTLINE_M = 0.05  # of a return that may still be one of the board's own
MAX_NEXT_BEAM_STEPS = 1.5  # from the last beam on the board to the next return


class OutlineCrossings(NamedTuple):
    """Unit rays (m, 3), sensor frame, where scan lines cross an outline; their rings (m,)."""

    rays: np.ndarray
    ring: np.ndarray


def find_outline_crossings(
    target: Board,
    T_sensor_target: np.ndarray,
    points: np.ndarray,
    ring: np.ndarray,
    *,
    azimuth_step: float,
    gate_m: float,
) -> OutlineCrossings:
    """Find the outline crossings in one scan.

    points (n, 3), ring (n,): all returns of the window; azimuth_step: of the scan pattern, rad. A
    beam is on the board if it ends within gate_m of its plane and over its outline. If the next
    beam of the ring has no return, the crossing is taken half a step beyond the last one.
    """
    q = transform_points(invert_pose(T_sensor_target), points)
    is_over = signed_polygon_distance(target.vertices, q[:, :2]) < MAX_OUTSIDE_OUTLINE_M
    is_on_board = is_over & (np.abs(q[:, 2]) < gate_m)
    rays, rings = [], []
    for r in np.unique(ring[is_on_board & (ring >= 0)]):
        line = np.flatnonzero(ring == r)
        azimuth = np.arctan2(points[line, 1], points[line, 0])
        middle = np.arctan2(*points[is_on_board & (ring == r)].mean(0)[1::-1])
        line = line[np.argsort((azimuth - middle + np.pi) % (2 * np.pi))]
        for side in (1, -1):
            rays.append(_crossing_ray(points[line], is_on_board[line], side, azimuth_step))
            rings.append(r)
    return OutlineCrossings(np.reshape(rays, (-1, 3)), np.array(rings, int))


def _crossing_ray(
    points: np.ndarray, is_on_board: np.ndarray, side: int, step: float
) -> np.ndarray:
    """Return the unit ray (3,) half a beam past the outermost beam on the board.

    points (n, 3): of one scan line, in order; side: 1 or -1; step: of the scan pattern, rad.
    """
    last = np.flatnonzero(is_on_board)[-1 if side > 0 else 0]
    last_ray = points[last] / np.linalg.norm(points[last])
    following = last + side
    next_ray = _rotate_about_z(last_ray, side * step)
    if 0 <= following < len(points):
        ray = points[following] / np.linalg.norm(points[following])
        if np.arccos(np.clip(last_ray @ ray, -1, 1)) < MAX_NEXT_BEAM_STEPS * step:
            next_ray = ray
    middle = last_ray + next_ray
    return middle / np.linalg.norm(middle)


def _rotate_about_z(ray: np.ndarray, angle: float) -> np.ndarray:
    """Return a ray (3,) rotated about z by an angle, rad."""
    return so3_exp(np.array([0.0, 0.0, angle])) @ ray
