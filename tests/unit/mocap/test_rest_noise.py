"""White and slow noise of motion capture, measured from bodies at rest."""

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from calib.geometry.se3 import se3_exp, so3_log
from calib.geometry.units import NS_PER_S
from calib.mocap.body_trajectory import Trajectory
from calib.mocap.rest_noise import (
    RestNoise,
    describe_rest_noise,
    mean_correlation,
    mean_variance_share,
    measure_rest_noise,
)
from simulation.sensors.mocap_errors import draw_gauss_markov

WHITE = np.repeat([0.00005, np.radians(0.005)], 3)
SLOW = np.append(np.full(3, 0.00015), np.radians([0.019, 0.070, 0.020]))
STATED = {"pose_bias_sigma": {"xyz_m": 0.0001, "rpy_deg": 0.01}, "use_measured_noise": False}


def rests_of(duration_s, count, pause_s=0.8):
    start = np.arange(count) * (duration_s + pause_s)
    return np.round(np.column_stack([start, start + duration_s]) * NS_PER_S).astype(np.int64)


def body_at_rest(rests, *, slow=SLOW, time_s=3.0, seed=0, lost=0.0, rate_hz=100):
    """A body that does not move, seen with white and slow noise; lost: share of the poses."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, rests[-1, 1], round(NS_PER_S / rate_hz))
    xi = WHITE * rng.standard_normal((len(t), 6))
    if np.any(slow):
        xi += slow * draw_gauss_markov(rng, t, time_s)
    seen = rng.random(len(t)) >= lost
    return Trajectory(t[seen], se3_exp(xi[seen]), 50_000_000)


@pytest.mark.parametrize("duration_s, count", [(0.8, 6), (0.8, 30), (60.0, 1)])
@pytest.mark.parametrize("seed", range(4))
def test_white_noise_leaves_no_slow_noise(duration_s, count, seed):
    rests = rests_of(duration_s, count)
    noise = measure_rest_noise(body_at_rest(rests, slow=0.0, seed=seed), rests)
    assert not noise.slow.any()
    assert noise.white == pytest.approx(WHITE, rel=0.25)
    assert noise.mean_sigma(1.0) == pytest.approx(WHITE / 10, rel=0.25)


@pytest.mark.parametrize("lost", [0.0, 0.29])
def test_the_scatter_of_means_over_a_second_is_measured_in_one_long_rest(lost):
    """0.15 mm and 0.019°, 0.070°, 0.020°, in 60 s at rest; white noise alone would leave 5 µm."""
    rests = rests_of(60.0, 1)
    noises = [
        measure_rest_noise(body_at_rest(rests, seed=seed, time_s=1.0, lost=lost), rests)
        for seed in range(6)
    ]
    expected = SLOW * np.sqrt(mean_variance_share(1.0, np.ones(6)))
    for noise in noises:
        assert noise.mean_sigma(1.0) == pytest.approx(expected, rel=0.45)
    assert np.mean([n.mean_sigma(1.0) for n in noises], 0) == pytest.approx(expected, rel=0.2)


def test_slow_noise_of_three_seconds_shows_in_rests_of_0_8_s():
    rests = rests_of(0.8, 30)
    noises = [measure_rest_noise(body_at_rest(rests, seed=seed), rests) for seed in range(8)]
    ratio = np.mean([n.slow for n in noises], 0) / SLOW
    assert (ratio > 0.6).all() and (ratio < 1.6).all()


@pytest.mark.parametrize("duration_s, count, time_s", [(0.8, 8, 0.7), (0.8, 8, 3.0), (5.0, 6, 3.0)])
def test_the_sigma_of_the_mean_of_a_rest_is_true_where_rests_are_few_and_short(
    duration_s, count, time_s
):
    """(σ true / σ estimated)², on average over 10 draws and the axes, is what NEES would be."""
    rests = rests_of(duration_s, count)
    noises = [
        measure_rest_noise(body_at_rest(rests, seed=seed, time_s=time_s), rests)
        for seed in range(10)
    ]
    expected = SLOW * np.sqrt(mean_variance_share(duration_s, time_s))
    nees = [(expected / n.slow_mean_sigma(duration_s)) ** 2 for n in noises]
    assert 0.6 < np.mean(nees) < 1.5


def test_noise_makes_the_speeds_that_are_stated():
    """Slopes over 0.3 s of 40 s with white and slow noise of 0.7 s."""
    rests = rests_of(40.0, 1)
    body = body_at_rest(rests, time_s=0.7, seed=3)
    xi = np.stack([np.concatenate([T[:3, 3], so3_log(T[:3, :3])]) for T in body.poses])
    s = (np.arange(30) - 14.5) / 100
    slopes = np.einsum("nks,s->nk", sliding_window_view(xi, 30, axis=0), s) / (s @ s)
    stated = RestNoise(WHITE, SLOW, np.full(6, 0.7), 0.01, 40.0, 40.0).speed_sigma(0.3)
    assert stated == pytest.approx(slopes.std(0), rel=0.15)


def test_bodies_without_rests_have_no_measured_noise():
    body = body_at_rest(rests_of(1.0, 1))
    assert measure_rest_noise(body, np.zeros((0, 2), np.int64)) is None
    assert measure_rest_noise(body, rests_of(0.1, 1)) is None


def test_a_pose_that_never_changes_has_no_noise():
    rests = rests_of(5.0, 1)
    exact = body_at_rest(rests, slow=0.0)
    frozen = Trajectory(exact.stamps_ns, np.tile(np.eye(4), (len(exact.stamps_ns), 1, 1)), 1)
    noise = measure_rest_noise(frozen, rests)
    assert not noise.slow.any() and noise.mean_sigma(1.0).max() < 1e-9


def test_means_of_a_gauss_markov_process_vary_and_correlate_as_stated():
    """Means over 1 s, 1.8 s apart, time constant 3 s; against 4000 s of it."""
    t = np.arange(0, 4000 * NS_PER_S, 20_000_000)
    x = draw_gauss_markov(np.random.default_rng(0), t, 3.0)
    second = (t // 200_000_000) % 9 < 5  # 1 s of every 1.8 s
    n = len(t) // 90
    means = x[: 90 * n][second[: 90 * n]].reshape(n, 50, 6).mean(1)
    assert (means**2).mean() == pytest.approx(mean_variance_share(1.0, 3.0), rel=0.05)
    found = np.mean([np.corrcoef(m[1:], m[:-1])[0, 1] for m in means.T])
    assert found == pytest.approx(mean_correlation(1.8, 1.0, 3.0), abs=0.03)


def test_the_note_says_how_far_motion_capture_scatters_and_what_to_state():
    rests = rests_of(60.0, 1)
    noise = measure_rest_noise(body_at_rest(rests, time_s=1.0), rests)
    text = describe_rest_noise("robot", noise, STATED)
    assert text.startswith("robot: motion capture scatters by 0.1") and "over a second" in text
    assert (
        "more than the stated mocap.pose_bias_sigma, 0.1 mm, 0.01°. Set it to {xyz_m: 0.0001"
        in text
    )
    enough = STATED | {"pose_bias_sigma": {"xyz_m": 0.0002, "rpy_deg": 0.1}}
    assert "Set it" not in describe_rest_noise("robot", noise, enough)
    assert "Set it" not in describe_rest_noise(
        "robot", noise, STATED | {"use_measured_noise": True}
    )
