"""Poses as functions of time: still at every placement, smooth in between."""

import numpy as np

from calib.geometry import pose, so3_exp, so3_log

START_NS = 1_700_000_000_000_000_000


def placement_times(count, hold_s, move_s):
    """Start and end (count, 2) of the placements, int64 ns."""
    start = START_NS + np.arange(count) * round((hold_s + move_s) * 1e9)
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


def poses_at(t, times, knots):
    """Poses (n, 4, 4) at t (n,), ns, of a body that rests at knots (count, 4, 4)."""
    k, s = blend(t, times)
    following = np.minimum(k + 1, len(knots) - 1)
    out = knots[k].copy()
    moving = s > 0
    if moving.any():
        out[moving] = between(knots[k[moving]], knots[following[moving]], s[moving])
    return out


def between(T0, T1, s):
    """Poses (n, 4, 4) at the fractions s (n,): straight in position, geodesic in rotation."""
    turn = so3_log(np.swapaxes(T0[..., :3, :3], -1, -2) @ T1[..., :3, :3])
    R = T0[..., :3, :3] @ so3_exp(s[..., None] * turn)
    return pose(R, T0[..., :3, 3] + s[..., None] * (T1[..., :3, 3] - T0[..., :3, 3]))


def values_at(t, times, knots):
    """Values (n, m) at t (n,), ns, blended between knots (count, m) as the poses are."""
    k, s = blend(t, times)
    following = np.minimum(k + 1, len(knots) - 1)
    return knots[k] + s[:, None] * (knots[following] - knots[k])
