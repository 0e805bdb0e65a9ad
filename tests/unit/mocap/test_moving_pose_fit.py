"""Poses of targets in motion between the samples of a slow motion capture."""

import numpy as np
import pytest

from calib.geometry.se3 import make_pose, se3_exp
from calib.geometry.units import NS_PER_S
from calib.mocap.body_trajectory import Trajectory, longest_gap_ns
from calib.mocap.moving_pose_fit import fit_local_motion

WHITE = np.repeat([0.0002, np.radians(0.02)], 3)


def target_y(s):
    """0.5 m in 0.8 s of every 1.8 s, with minimum jerk."""
    rest, phase_s = np.divmod(s, 1.8)
    share = np.clip((phase_s - 1.0) / 0.8, 0, 1)
    return 0.5 * (rest + share**3 * (10 - 15 * share + 6 * share**2))


def fits_in_motion(rate_hz, seed=0):
    """Errors (n,), m, along the path, and the fitted motions of a target on its way."""
    rng = np.random.default_rng(seed)
    t = np.round(np.arange(0, 6, 1 / rate_hz) * NS_PER_S).astype(np.int64)
    T = np.stack([make_pose(np.eye(3), [0.0, y, 0.0]) for y in target_y(t / NS_PER_S)])
    T = T @ se3_exp(WHITE * rng.standard_normal((len(t), 6)))
    trajectory = Trajectory(t, T, longest_gap_ns(t, 0.05))
    times_s = np.linspace(2.9, 3.5, 13)
    motions = [fit_local_motion(trajectory, round(s * NS_PER_S)) for s in times_s]
    errors = [m.T_robot_body[1, 3] - target_y(s) for m, s in zip(motions, times_s, strict=True)]
    return np.array(errors), motions


@pytest.mark.parametrize("rate_hz, error_m", [(12, 0.003), (8, 0.010), (5, 0.030)])
def test_the_sigma_of_a_slow_motion_capture_holds_what_its_samples_miss(rate_hz, error_m):
    errors, motions = fits_in_motion(rate_hz)
    sigma = np.array([m.unresolved_motion(WHITE)[1] for m in motions])
    assert np.sqrt(np.mean(errors**2)) > error_m / 2
    assert 0.25 < np.sqrt(np.mean(errors**2)) / np.sqrt(np.mean(sigma**2)) < 2.0
    assert np.abs(errors).max() < 3 * sigma.max()


def test_at_100_hz_the_samples_tell_the_motion():
    errors, motions = fits_in_motion(100)
    assert np.abs(errors).max() < 0.0005
    assert not any(m.unresolved_motion(WHITE).any() for m in motions)
