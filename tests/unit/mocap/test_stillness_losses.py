"""A body that is never still: how much time is lost to what, how fast it was, and what to do."""

from dataclasses import replace

import numpy as np
import pytest

from calib.geometry.se3 import se3_exp
from calib.geometry.units import NS_PER_S
from calib.mocap.body_trajectory import Trajectory
from calib.mocap.stillness import StillnessLimits, find_still_intervals
from calib.mocap.stillness_losses import (
    find_slowest_part,
    measure_time_losses,
    never_still_status,
)

LIMITS = StillnessLimits(
    window_s=0.3,
    max_linear_mps=0.01,
    max_angular_radps=np.radians(0.75),
    trim_s=0.1,
    min_duration_s=0.3,
    max_rest_gap_s=0.0,  # no rest spans a gap: each loss alone
)


def trajectory_along_x(t_s, x_m, yaw_deg=None, max_gap_s=0.05):
    """A body at x (n,), m, and yaw (n,), deg, at times (n,), s."""
    xi = np.zeros((len(t_s), 6))
    xi[:, 0], xi[:, 5] = x_m, np.radians(0 if yaw_deg is None else yaw_deg)
    return Trajectory(
        np.round(t_s * NS_PER_S).astype(np.int64), se3_exp(xi), round(max_gap_s * NS_PER_S)
    )


def status_of(trajectory, stamps_ns=None):
    assert len(find_still_intervals(trajectory, LIMITS)) == 0
    stamps_ns = trajectory.stamps_ns if stamps_ns is None else stamps_ns
    return never_still_status(
        "robot", "board", trajectory=trajectory, stamps_ns=stamps_ns, limits=LIMITS
    )


def test_motion_is_told_with_its_speed_in_the_slowest_part():
    t = np.arange(0, 10.001, 0.01)
    speed = np.where((t > 4) & (t < 6), 0.06, 0.20)
    moving = trajectory_along_x(t, np.cumsum(speed) * 0.01)
    losses = measure_time_losses(moving, moving.stamps_ns, LIMITS)
    assert losses.total == pytest.approx(10.0) and losses.motion == pytest.approx(9.7, abs=0.02)
    assert losses.gaps == pytest.approx(0.3, abs=0.02)  # half a window at both ends
    assert find_slowest_part(moving, LIMITS).linear == pytest.approx(0.06, rel=1e-6)
    status = status_of(moving)
    assert "9.7 s to speeds above 0.01 m/s and 0.75 deg/s" in status.found
    assert "the slowest 0.5 s are at up to 0.06 m/s and 0 deg/s" in status.found
    assert "gate." not in status.remedy  # no noise makes 6 times the limit


def test_a_turn_a_little_above_the_limit_may_be_noise_and_the_limit_that_helps_is_named():
    t = np.arange(0, 5.001, 0.01)
    turning = trajectory_along_x(t, 0 * t, yaw_deg=1.5 * t)
    status = status_of(turning)
    assert "at up to 0 m/s and 1.5 deg/s" in status.found
    assert "gate.max_angular_dps: 1.8" in status.remedy
    limits = StillnessLimits(0.3, 0.01, np.radians(1.8), 0.1, 0.3, 0.0)
    assert len(find_still_intervals(turning, limits)) == 1


def test_gaps_are_told_apart_from_motion():
    """At rest for 20 s, but lost for 0.2 s of every 0.6 s."""
    t = np.arange(0, 20.001, 0.01)
    t = t[t % 0.6 < 0.4]
    resting = trajectory_along_x(t, 0 * t)
    losses = measure_time_losses(resting, resting.stamps_ns, LIMITS)
    assert losses.motion == losses.rate == 0
    assert losses.short == pytest.approx(0.1 * 33, abs=0.7)
    assert losses.gaps == pytest.approx(20 - losses.short, abs=0.05)
    status = status_of(resting)
    assert "to gaps above 0.05 s" in status.found and "speeds" not in status.found
    assert "Keep the markers" in status.remedy


def test_gaps_that_a_rest_spans_are_no_loss():
    """At rest for 20 s, lost for 0.2 s of every 0.6 s: gate.max_rest_gap_s 0.5 s."""
    t = np.arange(0, 20.001, 0.01)
    resting = trajectory_along_x(t[t % 0.6 < 0.4], 0 * t[t % 0.6 < 0.4])
    limits = replace(LIMITS, max_rest_gap_s=0.5)
    assert len(find_still_intervals(resting, limits)) == 1
    assert measure_time_losses(resting, resting.stamps_ns, limits).gaps < 0.5


def test_a_robot_that_is_lost_all_the_time_is_a_gap():
    t = np.round(np.arange(0, 3, 0.01) * NS_PER_S).astype(np.int64)
    nothing = trajectory_along_x(np.zeros(0), np.zeros(0))
    status = status_of(nothing, t)
    assert status.found == "of 3.0 s are lost 3.0 s to gaps above 0.05 s"


def test_a_slow_motion_capture_is_told_with_its_rate_and_the_gap_to_set():
    t = np.arange(0, 10.001, 0.1)
    resting = trajectory_along_x(t, 0 * t)
    losses = measure_time_losses(resting, resting.stamps_ns, LIMITS)
    assert losses.rate == pytest.approx(10.0) and losses.gaps == pytest.approx(0.0)
    status = status_of(resting)
    assert "10.0 s to poses more than 0.05 s apart" in status.found
    assert "gives 10 poses a second: set mocap.max_gap_s: 0.15" in status.remedy
    assert "gate.window_s: 0.4" in status.remedy


def test_rests_that_are_too_short_are_told_with_how_long_to_hold():
    t = np.arange(0, 12.001, 0.01)
    swings = np.where(t % 2.0 < 1.3, 0.0, 0.2)  # 1 s at rest is less than half the windows take
    brief = trajectory_along_x(t, np.cumsum(swings * (t % 1.0 > 0.5)) * 0.01)
    limits = StillnessLimits(0.3, 0.01, np.radians(0.75), 0.1, 2.0, 0.0)
    losses = measure_time_losses(brief, brief.stamps_ns, limits)
    status = never_still_status(
        "robot", "board", trajectory=brief, stamps_ns=brief.stamps_ns, limits=limits
    )
    assert losses.short > losses.motion > 1.0
    assert "to rests that are too short" in status.found
    assert "2.5 s or more" in status.remedy and "gate.min_duration_s" in status.remedy
