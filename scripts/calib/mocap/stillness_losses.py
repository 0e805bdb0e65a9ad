"""Why a body is never still: time lost to gaps, to a low rate and to motion, and its speed."""

from typing import NamedTuple

import numpy as np

from calib.geometry.mask_runs import find_runs
from calib.geometry.units import DEG_PER_RAD, NS_PER_S
from calib.io.status import Status, failure_status
from calib.mocap.body_trajectory import Trajectory
from calib.mocap.stillness import StillnessLimits, find_bridged_gaps, rest_speeds

RATE_STEP_RATIO = 1.5  # a step up to this many times the median one is the rate, not a gap
SPEED_HEADROOM = 1.2  # of advised speed limits over the slowest speeds
MAX_NOISE_RATIO = 5.0  # slowest speeds up to this many limits may be noise of a body at rest


class TimeLosses(NamedTuple):
    """Where the time goes in which a body might be still, s.

    total: from the first to the last pose. gaps: poses are missing, or too near to a gap. rate:
    poses are farther apart than max_gap_s all the time. motion: above a speed limit. short: still,
    but not for long enough.
    """

    total: float
    gaps: float
    rate: float
    motion: float
    short: float


class SlowestPart(NamedTuple):
    """The largest speeds, m/s and rad/s, in the slowest part that is as long as a placement."""

    linear: float
    angular: float


def placement_length_s(limits: StillnessLimits) -> float:
    """Return how long a body must be below the speed limits for one placement, s."""
    return limits.min_duration_s + 2 * limits.trim_s


def measure_time_losses(
    trajectory: Trajectory, stamps_ns: np.ndarray, limits: StillnessLimits
) -> TimeLosses:
    """Return where the time is lost in a trajectory relative to the robot.

    stamps_ns: (n,) of all poses of the body, also where the robot is not known.
    """
    total = np.ptp(stamps_ns) / NS_PER_S if len(stamps_ns) else 0.0
    t = trajectory.stamps_ns
    if len(t) < 2:
        return TimeLosses(total, total, 0.0, 0.0, 0.0)
    step, bridged = np.diff(t), find_bridged_gaps(trajectory, limits)
    is_gap = (step > trajectory.max_gap_ns) & ~bridged
    is_rate = is_gap & (step <= RATE_STEP_RATIO * np.median(step))
    linear, angular = rest_speeds(trajectory, limits)
    is_known = np.isfinite(linear[:-1]) & ~is_gap
    is_fast = (linear[:-1] >= limits.max_linear_mps) | (angular[:-1] >= limits.max_angular_radps)
    rate, motion, short = (
        float(step[rows].sum()) / NS_PER_S
        for rows in (is_rate, is_known & is_fast, is_known & ~is_fast)
    )
    return TimeLosses(total, max(0.0, total - rate - motion - short), rate, motion, short)


def find_slowest_part(trajectory: Trajectory, limits: StillnessLimits) -> SlowestPart | None:
    """Return the speeds of the slowest part of the length of a placement; None if there is none."""
    linear, angular = rest_speeds(trajectory, limits)
    ratio = np.maximum(linear / limits.max_linear_mps, angular / limits.max_angular_radps)
    length_ns = placement_length_s(limits) * NS_PER_S

    def long_run(limit: float) -> np.ndarray | None:
        runs = find_runs(ratio <= limit)
        lengths = np.ptp(trajectory.stamps_ns[runs], axis=1) if len(runs) else np.zeros(0)
        return runs[lengths.argmax()] if len(runs) and lengths.max() >= length_ns else None

    candidates = np.unique(ratio[np.isfinite(ratio)])
    low, high = 0, len(candidates)
    while low < high:
        middle = (low + high) // 2
        low, high = (
            (low, middle) if long_run(candidates[middle]) is not None else (middle + 1, high)
        )
    run = long_run(candidates[low]) if low < len(candidates) else None
    if run is None:
        return None
    rows = slice(run[0], run[1] + 1)
    return SlowestPart(float(linear[rows].max()), float(angular[rows].max()))


def never_still_status(
    robot: str,
    body: str,
    *,
    trajectory: Trajectory,
    stamps_ns: np.ndarray,
    limits: StillnessLimits,
) -> Status:
    """Return why a body is never still relative to the robot: see measure_time_losses."""
    losses = measure_time_losses(trajectory, stamps_ns, limits)
    slowest = find_slowest_part(trajectory, limits)
    gap_s = trajectory.max_gap_ns / NS_PER_S
    limit_text = _format_speeds(limits.max_linear_mps, limits.max_angular_radps)
    parts = (
        (losses.gaps, f"to gaps above {gap_s:g} s"),
        (losses.rate, f"to poses more than {gap_s:g} s apart"),
        (losses.motion, f"to speeds above {limit_text}"),
        (losses.short, "to rests that are too short"),
    )
    lost = [f"{seconds:.1f} s {cause}" for seconds, cause in parts if seconds >= 0.05]
    found = f"of {losses.total:.1f} s are lost {', '.join(lost) or 'all'}"
    if slowest:
        found += (
            f"; the slowest {placement_length_s(limits):.1f} s are at up to "
            f"{_format_speeds(*slowest)}"
        )
    return failure_status(
        f"{body} is never still relative to {robot}",
        found,
        f"{placement_length_s(limits):.1f} s or more below {limit_text}",
        _never_still_remedy(losses, slowest, trajectory, limits),
    )


def _format_speeds(linear_mps: float, angular_radps: float) -> str:
    return f"{linear_mps:.2g} m/s and {angular_radps * DEG_PER_RAD:.2g} deg/s"


def _never_still_remedy(
    losses: TimeLosses,
    slowest: SlowestPart | None,
    trajectory: Trajectory,
    limits: StillnessLimits,
) -> str:
    """Return what to do about the largest loss."""
    largest = max(losses.gaps, losses.rate, losses.motion, losses.short)
    hold_s = placement_length_s(limits) + limits.window_s
    if largest == losses.rate:
        step_s = float(np.median(np.diff(trajectory.stamps_ns))) / NS_PER_S
        return (
            f"Motion capture gives {1 / step_s:.3g} poses a second: set mocap.max_gap_s: "
            f"{RATE_STEP_RATIO * step_s:.2g} and gate.window_s: "
            f"{max(limits.window_s, 4 * step_s):.2g}, or raise its rate."
        )
    if largest == losses.gaps:
        return (
            "Keep the markers of robot and target in view of the motion capture, and hold the "
            f"target still for {hold_s:.1f} s or more."
        )
    advice = f"Hold robot and target still for {hold_s:.1f} s or more."
    if largest == losses.motion and slowest and _may_be_noise(slowest, limits):
        linear = max(SPEED_HEADROOM * slowest.linear, limits.max_linear_mps)
        angular = max(SPEED_HEADROOM * slowest.angular, limits.max_angular_radps)
        advice += (
            f" If they were, motion capture is noisy: set gate.max_linear_mps: {linear:.2g} and "
            f"gate.max_angular_dps: {angular * DEG_PER_RAD:.2g}."
        )
    if largest == losses.short:
        advice += " Or reduce gate.min_duration_s and gate.trim_s."
    return advice


def _may_be_noise(slowest: SlowestPart, limits: StillnessLimits) -> bool:
    """Return whether noise of motion capture may explain the slowest speeds of a body at rest."""
    return (
        slowest.linear <= MAX_NOISE_RATIO * limits.max_linear_mps
        and slowest.angular <= MAX_NOISE_RATIO * limits.max_angular_radps
    )
