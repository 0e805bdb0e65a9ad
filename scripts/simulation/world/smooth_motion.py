"""Compute poses over time: still at every placement, smooth in between."""

from collections.abc import Callable

import numpy as np

from calib.geometry.se3 import make_pose, so3_exp, so3_log
from calib.geometry.units import NS_PER_S

SIMULATION_START_NS = 1_700_000_000_000_000_000


PositionPath = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def schedule_placements(time_slots: np.ndarray, hold_s: float, move_s: float) -> np.ndarray:
    """Return start and end (n, 2), int64 ns, of placements that begin in the time slots (n,).

    A slot is as long as one placement and one move.
    """
    start = SIMULATION_START_NS + np.asarray(time_slots, np.int64) * round(
        (hold_s + move_s) * NS_PER_S
    )
    return np.stack([start, start + round(hold_s * NS_PER_S)], -1)


def find_motion_progress(
    t: np.ndarray, placement_times_ns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the placement (n,) before times t (n,), ns, and the fraction (n,) of the way onwards.

    The fraction is that of a minimum-jerk motion: 0 during a placement, with no velocity and no
    acceleration where a motion starts and ends. Before the first and after the last all is still.
    """
    t = np.asarray(t, np.int64)
    k = np.clip(
        np.searchsorted(placement_times_ns[:, 0], t, side="right") - 1,
        0,
        len(placement_times_ns) - 1,
    )
    following = np.minimum(k + 1, len(placement_times_ns) - 1)
    length = np.maximum(placement_times_ns[following, 0] - placement_times_ns[k, 1], 1)
    s = np.where(following > k, np.clip((t - placement_times_ns[k, 1]) / length, 0, 1), 0.0)
    return k, s**3 * (10 - 15 * s + 6 * s * s)


def interpolate_line(p0: np.ndarray, p1: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Return points (n, 3) at fractions (n, 1) of the straight way."""
    return p0 + fraction * (p1 - p0)


def interpolate_around_robot(p0: np.ndarray, p1: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Return points (n, 3) at fractions (n, 1) of the shorter way around the z axis.

    A target that goes from the front to the rear is carried around the robot.
    """
    (r0, a0), (r1, a1) = (_to_polar(p) for p in (p0, p1))
    turn = (a1 - a0 + np.pi) % (2 * np.pi) - np.pi
    r, a = r0 + fraction * (r1 - r0), a0 + fraction * turn
    return np.concatenate(
        [r * np.cos(a), r * np.sin(a), interpolate_line(p0, p1, fraction)[:, 2:]], axis=1
    )


def _to_polar(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.hypot(p[:, :1], p[:, 1:2]), np.arctan2(p[:, 1:2], p[:, :1])


def interpolate_placement_poses(
    t: np.ndarray,
    placement_times_ns: np.ndarray,
    placement_poses: np.ndarray,
    interpolate_position: PositionPath = interpolate_line,
) -> np.ndarray:
    """Return poses (n, 4, 4) at t (n,), ns, of a body that rests at placement_poses (m, 4, 4)."""
    k, s = find_motion_progress(t, placement_times_ns)
    following = np.minimum(k + 1, len(placement_poses) - 1)
    out = placement_poses[k].copy()
    moving = s > 0
    if moving.any():
        out[moving] = interpolate_pose_pair(
            placement_poses[k[moving]],
            placement_poses[following[moving]],
            s[moving],
            interpolate_position,
        )
    return out


def interpolate_pose_pair(
    T0: np.ndarray,
    T1: np.ndarray,
    fraction: np.ndarray,
    interpolate_position: PositionPath = interpolate_line,
) -> np.ndarray:
    """Return poses (n, 4, 4) at fractions (n,): positions along the path, rotations geodesic."""
    turn = so3_log(np.swapaxes(T0[..., :3, :3], -1, -2) @ T1[..., :3, :3])
    R = T0[..., :3, :3] @ so3_exp(fraction[..., None] * turn)
    return make_pose(R, interpolate_position(T0[..., :3, 3], T1[..., :3, 3], fraction[..., None]))


def interpolate_placement_values(
    t: np.ndarray, placement_times_ns: np.ndarray, placement_values: np.ndarray
) -> np.ndarray:
    """Return values (n, m) at t (n,), ns, blended between those of placements like the poses."""
    k, s = find_motion_progress(t, placement_times_ns)
    following = np.minimum(k + 1, len(placement_values) - 1)
    return placement_values[k] + s[:, None] * (placement_values[following] - placement_values[k])
