"""Poses as functions of time: still at every placement, smooth in between."""

import numpy as np

from calib.geometry.se3 import pose, so3_exp, so3_log

START_NS = 1_700_000_000_000_000_000


def placement_times(slots, hold_s, move_s):
    """Start and end (n, 2) of placements, int64 ns, that begin in the slots (n,) of time, each as
    long as a placement and a move."""
    start = START_NS + np.asarray(slots, np.int64) * round((hold_s + move_s) * 1e9)
    return np.stack([start, start + round(hold_s * 1e9)], -1)


def blend(t, times):
    """Placement (n,) before the times t (n,), ns, and the fraction (n,) of the way to the next.

    The fraction is that of a minimum-jerk motion: 0 during a placement, with no velocity and no
    acceleration where a motion starts and ends. Before the first and after the last all is still.
    """
    t = np.asarray(t, np.int64)
    k = np.clip(np.searchsorted(times[:, 0], t, side="right") - 1, 0, len(times) - 1)
    following = np.minimum(k + 1, len(times) - 1)
    length = np.maximum(times[following, 0] - times[k, 1], 1)
    s = np.where(following > k, np.clip((t - times[k, 1]) / length, 0, 1), 0.0)
    return k, s**3 * (10 - 15 * s + 6 * s * s)


def straight(p0, p1, s):
    """Points (n, 3) at the fractions s (n, 1) of the way."""
    return p0 + s * (p1 - p0)


def around(p0, p1, s):
    """Points (n, 3) at the fractions s (n, 1) of the shorter way around the z axis: a target that
    goes from the front to the rear is carried around the robot."""
    (r0, a0), (r1, a1) = (_polar(p) for p in (p0, p1))
    turn = (a1 - a0 + np.pi) % (2 * np.pi) - np.pi
    r, a = r0 + s * (r1 - r0), a0 + s * turn
    return np.concatenate([r * np.cos(a), r * np.sin(a), straight(p0, p1, s)[:, 2:]], axis=1)


def _polar(p):
    return np.hypot(p[:, :1], p[:, 1:2]), np.arctan2(p[:, 1:2], p[:, :1])


def poses_at(t, times, knots, path=straight):
    """Poses (n, 4, 4) at t (n,), ns, of a body that rests at knots (count, 4, 4)."""
    k, s = blend(t, times)
    following = np.minimum(k + 1, len(knots) - 1)
    out = knots[k].copy()
    moving = s > 0
    if moving.any():
        out[moving] = between(knots[k[moving]], knots[following[moving]], s[moving], path)
    return out


def between(T0, T1, s, path=straight):
    """Poses (n, 4, 4) at the fractions s (n,): along the path in position, geodesic in rotation."""
    turn = so3_log(np.swapaxes(T0[..., :3, :3], -1, -2) @ T1[..., :3, :3])
    R = T0[..., :3, :3] @ so3_exp(s[..., None] * turn)
    return pose(R, path(T0[..., :3, 3], T1[..., :3, 3], s[..., None]))


def values_at(t, times, knots):
    """Values (n, m) at t (n,), ns, blended between knots (count, m) as the poses are."""
    k, s = blend(t, times)
    following = np.minimum(k + 1, len(knots) - 1)
    return knots[k] + s[:, None] * (knots[following] - knots[k])
