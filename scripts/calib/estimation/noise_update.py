"""Update the noise of the estimate after a round, from residuals and leverage."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.estimation.estimate_state import State
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import SolveResult
from calib.estimation.nlp.information_matrix import invert_information
from calib.estimation.noise_model import (
    NoiseKey,
    estimate_measurement_noise,
    noise_key,
    split_common_noise,
    update_mocap_factor,
)
from calib.estimation.residuals.assignment import Assignment
from calib.estimation.round_solution import RoundSolution


def update_noise(setup: Setup, solution: RoundSolution, assignments: Sequence[Assignment]) -> State:
    """Return the State after a solution with the noise that the residuals show.

    assignments: at that State. The common part of the noise is split off once the sensors move by
    less than their σ.
    """
    state, posterior = solution.state, invert_information(solution.solve_result.information)
    noise = estimate_measurement_noise(setup, assignments, state.noise)
    twists = solution.sensor_twists.reshape(-1)
    if np.all(twists**2 < np.diag(posterior)[: twists.size]):
        leverage = residual_leverage(setup, solution.solve_result, posterior)
        noise = split_common_noise(setup, assignments, noise, leverage)
    mocap_factor = estimate_mocap_factor(setup, state, posterior)
    return replace(
        state,
        mocap_errors=state.mocap_errors * state.mocap_noise_factor / mocap_factor,
        noise=noise,
        mocap_noise_factor=mocap_factor,
    )


def residual_leverage(
    setup: Setup, solve_result: SolveResult, posterior_covariance: np.ndarray
) -> dict[NoiseKey, float]:
    """Return the leverage of all residuals of each noise: how many the estimate uses up."""
    leverage: dict[NoiseKey, float] = {}
    for g, factor in zip(setup.groups, solve_result.factors, strict=True):
        covariance = posterior_covariance[np.ix_(factor.columns, factor.columns)]
        part = float(np.sum(factor.hessian_x * covariance))
        leverage[noise_key(g)] = leverage.get(noise_key(g), 0.0) + part
    return leverage


def estimate_mocap_factor(setup: Setup, state: State, posterior_covariance: np.ndarray) -> float:
    """Return the factor on the σ of the motion capture poses; see update_mocap_factor.

    Targets compared with template points do not count: errors by the spacing of a template, common
    to a whole placement, would pass for errors of the motion capture.
    """
    still = setup.placements[: setup.n_still]
    is_exact = np.array([setup.targets[p.target].uses_exact_surface for p in still], bool)
    robots, bodies = (
        index[: setup.n_still] for index in (setup.robot_error_index, setup.body_error_index)
    )
    counts = np.zeros(len(setup.mocap_sigma), bool)
    counts[robots] = counts[bodies] = True
    counts[robots[~is_exact]] = counts[bodies[~is_exact]] = False
    variances = np.diag(posterior_covariance)[setup.n_pose_unknowns : setup.n_chain_unknowns]
    determined_share = 1 - variances.reshape(-1, 6)
    return update_mocap_factor(
        state.mocap_errors[counts], determined_share[counts], state.mocap_noise_factor
    )
