"""When a body is still against another, and for how long."""

import numpy as np

from calib.geometry.se3 import so3_log
from calib.geometry.units import NS_PER_S
from calib.mocap import body_trajectory


def _fit_window_slopes(t, y, first, last):
    """Least-squares slopes (n, k) of y (n, k) over t (n,), s, in the windows [first, last)."""

    def total(values):
        cumulative = np.concatenate([np.zeros((1,) + values.shape[1:]), np.cumsum(values, 0)])
        return cumulative[last] - cumulative[first]

    n = (last - first)[:, None].astype(float)
    s, sy = total(t[:, None]), total(y)
    spread = total(t[:, None] ** 2) - s * s / n
    return (total(t[:, None] * y) - s * sy / n) / np.where(spread > 0, spread, np.inf)


def trajectory_speeds(trajectory, window_s):
    """Linear (n,), m/s, and angular (n,), rad/s, speed at every sample, as slopes over a window.

    A slope over all samples of the window averages the noise of the MCS, which the difference of
    two poses would not; turning is summed from sample to sample, so it has no singular angle.
    The slope of an oscillation vanishes where it fits the window, so its half and its quarter
    count as well, at 1/4 and 1/16: noise, which grows with window^-1.5, stays below the whole's.
    Infinite where the window is not covered without a gap.
    """
    t = trajectory.stamps_ns
    if len(t) < 3:
        return np.full(len(t), np.inf), np.full(len(t), np.inf)
    half = round(window_s * NS_PER_S / 2)
    seconds = (t - t[0]) / NS_PER_S
    turns = so3_log(np.swapaxes(trajectory.poses[:-1, :3, :3], 1, 2) @ trajectory.poses[1:, :3, :3])
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(turns, 0)])
    moved = np.stack([trajectory.poses[:, :3, 3], turned])
    fastest = np.zeros((2, len(t)))
    for share in (1, 2, 4):
        first, last = body_trajectory._window_bounds(t, half // share)
        slope = np.stack(
            [np.linalg.norm(_fit_window_slopes(seconds, y, first, last), axis=1) for y in moved]
        )
        fastest = np.maximum(fastest, np.where(last - first >= 3, slope / share**2, 0.0))
    first, last = body_trajectory._window_bounds(t, half)
    fastest[:, ~(_is_window_covered(t, half, trajectory.max_gap_ns) & (last - first >= 3))] = np.inf
    return fastest[0], fastest[1]


def _is_window_covered(t, half_width_ns, max_gap_ns):
    """Whether the samples reach half, ns, to both sides of each without a gap."""
    gaps = np.flatnonzero(np.diff(t) > max_gap_ns)
    starts, ends = t[np.append(0, gaps + 1)], t[np.append(gaps, len(t) - 1)]
    part = np.searchsorted(starts, t, "right") - 1
    return (t - half_width_ns >= starts[part]) & (t + half_width_ns <= ends[part])


def find_still_intervals(
    trajectory, window_s, max_linear_mps, max_angular_radps, trim_s, min_duration_s
):
    """(k, 2) starts and ends, ns, of the maximal intervals without motion, trimmed at both ends."""
    linear, angular = trajectory_speeds(trajectory, window_s)
    still = (linear < max_linear_mps) & (angular < max_angular_radps)
    edges = np.diff(np.concatenate([[False], still, [False]]).astype(int))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    trim = round(trim_s * NS_PER_S)
    spans = np.column_stack(
        [trajectory.stamps_ns[starts] + trim, trajectory.stamps_ns[ends] - trim]
    )
    return spans[spans[:, 1] - spans[:, 0] >= min_duration_s * NS_PER_S].reshape(-1, 2)


def fit_residual_drift(stamps_ns, deviations):
    """Slope (6,), per s, of deviations deviations (n, 6) from a mean pose over stamps_ns (n,), ns."""
    s = (stamps_ns - stamps_ns.mean()) / NS_PER_S
    return s @ deviations / max(s @ s, 1e-300)


def count_effective_samples(deviations):
    """Number of independent samples among deviations deviations (n, k), from their autocorrelation.

    Sum of the correlations up to the first that is not positive (Geyer's initial sequence, cut
    early), averaged over the components weighted by their variance.
    """
    n = len(deviations)
    power = (deviations * deviations).sum()
    # Poses repeated to the last digit are one measurement, however often they are sent.
    if n < 4 or power < 1e-20 * n:
        return 1.0
    total = 0.0
    for lag in range(1, n // 2):
        correlation = (deviations[lag:] * deviations[:-lag]).sum() / power
        if correlation <= 0:
            break
        total += correlation
    return max(1.0, n / (1 + 2 * total))
