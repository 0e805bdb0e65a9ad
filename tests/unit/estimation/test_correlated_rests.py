"""Slow noise of motion capture that lasts from one rest to the next is part of σ."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.estimation.estimation_problem import SlowNoise
from calib.estimation.estimation_result import EstimationResult, SolveResult
from calib.estimation.noise.correlated_rests import error_correlation, with_correlated_rests
from calib.geometry.units import NS_PER_S
from calib.mocap.rest_noise import mean_variance_share
from simulation.sensors.mocap_errors import draw_gauss_markov

N_RESTS, REST_S, STEP_S, TIME_S, SLOW = 12, 1.0, 1.8, 3.0, 0.07
BIAS = 0.01
MEAN_SIGMA = SLOW * float(mean_variance_share(REST_S, TIME_S)) ** 0.5


def make_setup(slow=MEAN_SIGMA, n=N_RESTS):
    """A sensor that each rest sees exactly; the errors are those of the robot's pose."""
    noise = SlowNoise(np.stack([np.full(6, slow), np.zeros(6)]), np.full((2, 6), TIME_S), REST_S)
    places = [
        SimpleNamespace(
            session="s",
            target="board",
            start_ns=round(k * STEP_S * NS_PER_S),
            slow_noise=noise if slow else None,
        )
        for k in range(n)
    ]
    sigma = np.vstack([np.full((n, 6), np.hypot(slow, BIAS)), np.full((n, 6), BIAS)])
    return SimpleNamespace(
        placements=places,
        n_still=n,
        n_pose_unknowns=6,
        mocap_sigma=sigma,
        robot_error_index=np.arange(n),
        body_error_index=n + np.arange(n),
    )


def solved_mean(setup):
    """The result of a pose measured once per rest, exactly but for the robot's error."""
    size = setup.mocap_sigma.size
    H = np.zeros((6 + size, 6 + size))
    H[6:, 6:] = np.eye(size)
    for k, sigma in enumerate(setup.mocap_sigma[: setup.n_still]):
        J = np.zeros((6, 6 + size))
        J[:, :6] = np.eye(6)
        J[:, 6 + 6 * k : 12 + 6 * k] = np.diag(sigma)
        H += J.T @ J / (1e-4) ** 2
    solve_result = SolveResult([], H, 0.0, 1, "ok", True)
    return EstimationResult(SimpleNamespace(), solve_result, [], [], True)


def pose_sigma(result):
    return np.sqrt(np.diag(result.solved.covariance)[:6])


def test_the_sigma_of_a_mean_over_correlated_rests_is_that_of_draws():
    """12 rests of 1 s every 1.8 s, slow noise of 3 s: σ of the mean from 3000 draws."""
    setup = make_setup()
    found = pose_sigma(with_correlated_rests(setup, solved_mean(setup)))
    t = np.arange(0, 500 * 30 * NS_PER_S, NS_PER_S // 20)
    x = SLOW * draw_gauss_markov(np.random.default_rng(0), t, TIME_S)
    draws = x.reshape(500, -1, 6)[:, : round(N_RESTS * STEP_S * 20)]
    resting = np.arange(draws.shape[1]) / 20 % STEP_S < REST_S
    sigma = np.sqrt((draws[:, resting].mean(1) ** 2).mean() + BIAS**2 / N_RESTS)
    assert found == pytest.approx(np.full(6, sigma), rel=0.06)
    independent = pose_sigma(solved_mean(setup))
    assert found.min() > 1.5 * independent.max()


def test_nothing_changes_without_slow_noise():
    setup = make_setup(slow=0.0)
    result = solved_mean(setup)
    assert with_correlated_rests(setup, result) is result


def test_errors_of_different_bodies_and_sessions_are_independent():
    setup = make_setup()
    R = error_correlation(setup)
    robots = R[: 6 * N_RESTS, : 6 * N_RESTS]
    assert np.allclose(R[6 * N_RESTS :, 6 * N_RESTS :], np.eye(6 * N_RESTS))
    assert robots[0, 6] > 0.5 and robots[0, 1] == 0 and robots[0, 6 * 11] < 0.02
    other = make_setup()
    for place in other.placements[6:]:
        place.session = "other"
    assert error_correlation(other)[6 * 5, 6 * 6] == 0


def test_an_unobservable_direction_stays_so():
    setup = make_setup()
    result = solved_mean(setup)
    H = result.solved.information.copy()
    H[0], H[:, 0] = 0.0, 0.0
    result = replace(result, solve_result=replace(result.solved, information=H))
    information = with_correlated_rests(setup, result).solved.information
    assert np.abs(information[0]).max() < 1e-6 and np.isfinite(information).all()
