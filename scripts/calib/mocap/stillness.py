"""Intervals in which a body is still relative to another, and how much its poses there tell."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.geometry.mask_runs import find_runs
from calib.geometry.se3 import so3_log
from calib.geometry.units import NS_PER_S
from calib.mocap.body_trajectory import Trajectory, window_bounds

NOISE_SPEEDS = 3.0  # rms of the speeds that noise makes, which a body at rest stays below


@dataclass(frozen=True)
class StillnessLimits:
    """When a body counts as still: block `gate` of the config, angular speed in rad/s."""

    window_s: float
    max_linear_mps: float
    max_angular_radps: float
    trim_s: float
    min_duration_s: float
    max_rest_gap_s: float

    @classmethod
    def from_config(cls, options: dict[str, Any]) -> "StillnessLimits":
        """Return the limits of block `gate`."""
        return cls(
            window_s=options["window_s"],
            max_linear_mps=options["max_linear_mps"],
            max_angular_radps=np.radians(options["max_angular_dps"]),
            trim_s=options["trim_s"],
            min_duration_s=options["min_duration_s"],
            max_rest_gap_s=options["max_rest_gap_s"],
        )

    def raised_by(self, linear_mps: float, angular_radps: float) -> "StillnessLimits":
        """Return limits above the speeds of this rms, m/s and rad/s, that noise alone makes."""
        return replace(
            self,
            max_linear_mps=max(self.max_linear_mps, NOISE_SPEEDS * linear_mps),
            max_angular_radps=max(self.max_angular_radps, NOISE_SPEEDS * angular_radps),
        )


def _fit_window_slopes(
    t: np.ndarray, y: np.ndarray, first: np.ndarray, last: np.ndarray, window_s: float
) -> np.ndarray:
    """Return least-squares slopes (n, k) of y (n, k) over t (n,), s, in windows [first, last).

    Samples that crowd together in a part of the window count as spread over half of it: their own
    slope is noise.
    """

    def total(values: np.ndarray) -> np.ndarray:
        cumulative = np.concatenate([np.zeros((1,) + values.shape[1:]), np.cumsum(values, 0)])
        return cumulative[last] - cumulative[first]

    n = (last - first)[:, None].astype(float)
    s, sy = total(t[:, None]), total(y)
    least_spread = n * (window_s / 2) ** 2 / 12
    spread = np.maximum(total(t[:, None] ** 2) - s * s / n, np.where(n > 1, least_spread, 0.0))
    return (total(t[:, None] * y) - s * sy / n) / np.where(spread > 0, spread, np.inf)


def trajectory_speeds(
    trajectory: Trajectory, window_s: float, bridged: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return linear (n,), m/s, and angular (n,), rad/s, speed at every sample.

    Speeds are slopes over a window: a slope over all samples averages the noise of motion capture,
    which the difference of two poses does not. Rotations are summed from sample to sample, so no
    angle is singular. The slope of an oscillation vanishes if it fits the window, so half and
    quarter windows count as well, with weights 1/4 and 1/16: noise grows with window^-1.5, so
    theirs stays below that of the whole window. Infinite where the window has a gap that is not
    bridged (n - 1,). The window of a slow stream is longer: at least three samples.
    """
    t = trajectory.stamps_ns
    if len(t) < 3:
        return np.full(len(t), np.inf), np.full(len(t), np.inf)
    half_ns = _half_window_ns(t, window_s)
    seconds, motions = (t - t[0]) / NS_PER_S, _cumulative_motions(trajectory)
    fastest = np.zeros((2, len(t)))
    for share in (1, 2, 4):
        first, last = window_bounds(t, half_ns // share)
        slope = np.stack(
            [
                np.linalg.norm(
                    _fit_window_slopes(seconds, y, first, last, 2 * half_ns / share / NS_PER_S),
                    axis=1,
                )
                for y in motions
            ]
        )
        fastest = np.maximum(fastest, np.where(last - first >= 3, slope / share**2, 0.0))
    first, last = window_bounds(t, half_ns)
    is_gap = np.diff(t) > trajectory.max_gap_ns
    if bridged is None:
        enough, breaks = last - first >= 3, is_gap
    else:
        # Few poses between bridged gaps: they are where the rest is.
        enough = (last - first >= 3) | np.append(bridged, False) | np.append(False, bridged)
        breaks = is_gap & ~bridged
    fastest[:, ~(_is_window_covered(t, half_ns, breaks) & enough)] = np.inf
    return fastest[0], fastest[1]


def _half_window_ns(t: np.ndarray, window_s: float) -> int:
    """Return half of the window, ns: at least 1.5 periods of the stamps t (n,)."""
    return max(round(window_s * NS_PER_S / 2), round(1.5 * float(np.median(np.diff(t)))))


def _cumulative_motions(trajectory: Trajectory) -> np.ndarray:
    """Return positions and rotations (2, n, 3); rotations are summed from sample to sample."""
    turns = so3_log(np.swapaxes(trajectory.poses[:-1, :3, :3], 1, 2) @ trajectory.poses[1:, :3, :3])
    rotations = np.concatenate([np.zeros((1, 3)), np.cumsum(turns, 0)])
    return np.stack([trajectory.poses[:, :3, 3], rotations])


def find_bridged_gaps(trajectory: Trajectory, limits: StillnessLimits) -> np.ndarray:
    """Return which steps (n - 1,) are gaps with the same pose on both sides.

    The mean poses of half a window before and after differ by no more than a motion at the limits
    of speed within the window.
    """
    t = trajectory.stamps_ns
    out = np.zeros(max(len(t) - 1, 0), bool)
    if len(t) < 3:
        return out
    steps = np.diff(t)
    is_gap = (steps > trajectory.max_gap_ns) & (steps <= limits.max_rest_gap_s * NS_PER_S)
    motions, half_ns = _cumulative_motions(trajectory), _half_window_ns(t, limits.window_s)
    for gap in np.flatnonzero(is_gap).tolist():
        first = int(np.searchsorted(t, t[gap] - half_ns))
        last = int(np.searchsorted(t, t[gap + 1] + half_ns, "right"))
        before, after = motions[:, first : gap + 1], motions[:, gap + 1 : last]
        distance, angle = np.linalg.norm(after.mean(1) - before.mean(1), axis=1)
        out[gap] = (
            distance < limits.max_linear_mps * limits.window_s
            and angle < limits.max_angular_radps * limits.window_s
        )
    return out


def _is_window_covered(t: np.ndarray, half_width_ns: int, breaks: np.ndarray) -> np.ndarray:
    """Return whether the samples cover the window around each sample without a break, (n,) bool.

    breaks: (n - 1,) steps that are gaps.
    """
    gaps = np.flatnonzero(breaks)
    starts, ends = t[np.append(0, gaps + 1)], t[np.append(gaps, len(t) - 1)]
    part = np.searchsorted(starts, t, "right") - 1
    return (t - half_width_ns >= starts[part]) & (t + half_width_ns <= ends[part])


def rest_speeds(trajectory: Trajectory, limits: StillnessLimits) -> tuple[np.ndarray, np.ndarray]:
    """Return the speeds of trajectory_speeds, with gaps bridged that a rest may span."""
    bridged = find_bridged_gaps(trajectory, limits)
    return trajectory_speeds(trajectory, limits.window_s, bridged)


def find_still_intervals(trajectory: Trajectory, limits: StillnessLimits) -> np.ndarray:
    """Return starts and ends (k, 2), ns, of the maximal still intervals, trimmed at both ends.

    They span short gaps with the same pose on both sides. In a slow stream the poses before and
    after one tell of more than the window.
    """
    t = trajectory.stamps_ns
    linear, angular = rest_speeds(trajectory, limits)
    is_still = (linear < limits.max_linear_mps) & (angular < limits.max_angular_radps)
    period_ns = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    beyond_ns = max(0, round(period_ns - limits.window_s * NS_PER_S / 2))
    trim_ns = round(limits.trim_s * NS_PER_S) - beyond_ns
    intervals = trajectory.stamps_ns[find_runs(is_still)] + [trim_ns, -trim_ns]
    is_long = intervals[:, 1] - intervals[:, 0] >= limits.min_duration_s * NS_PER_S
    return intervals[is_long].reshape(-1, 2)


def fit_residual_drift(stamps_ns: np.ndarray, deviations: np.ndarray) -> np.ndarray:
    """Return the slope (6,), per s, of deviations (n, 6) from a mean pose over stamps_ns (n,)."""
    s = (stamps_ns - stamps_ns.mean()) / NS_PER_S
    return s @ deviations / max(s @ s, 1e-300)


def count_effective_samples(deviations: np.ndarray) -> float:
    """Return the number of independent samples among deviations (n, k), by their autocorrelation.

    Correlations are summed up to the first that is not positive (Geyer's initial sequence, cut
    early), averaged over the components with their variances as weights.
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
