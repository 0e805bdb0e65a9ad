"""Slow noise of motion capture that lasts from one rest to the next.

The priors of the pose errors are independent. Where slow noise is correlated over several rests,
its share in the estimate averages out less, and σ grows by that.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.estimation.estimation_problem import Placement, Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.nlp.information_matrix import invert_information
from calib.geometry.units import NS_PER_S
from calib.mocap.rest_noise import mean_correlation

MIN_EIGENVALUE = 1e-9  # of a correlation matrix; rounding


def with_correlated_rests(setup: Setup, result: EstimationResult) -> EstimationResult:
    """Return the result with its information decreased by correlations between rests.

    The estimate weighs the rests as independent. With H its information and R the correlation of
    the errors, its covariance is H⁻¹ + H⁻¹ E (R − 1) Eᵀ H⁻¹, E picking the errors.
    """
    if result.solve_result is None or not any(p.slow_noise for p in setup.placements):
        return result
    H = result.solved.information
    excess = error_correlation(setup)
    first = setup.n_pose_unknowns
    rows = slice(first, first + len(excess))
    total = H.copy()
    total[rows, rows] += excess - np.eye(len(excess))
    information = H @ invert_information(total) @ H
    information = (information + information.T) / 2
    return replace(result, solve_result=replace(result.solved, information=information))


def error_correlation(setup: Setup) -> np.ndarray:
    """Return the correlation (6 r, 6 r) of the r motion capture errors."""
    R = np.eye(setup.mocap_sigma.size)
    robots, bodies = setup.robot_error_index, setup.body_error_index
    _add_correlations(R, setup, robots, 0, lambda p: (p.session, ""))
    _add_correlations(R, setup, bodies, 1, lambda p: (p.session, p.target))
    return R


def _add_correlations(
    R: np.ndarray,
    setup: Setup,
    error_index: np.ndarray,
    part: int,
    key: Callable[[Placement], tuple[str, str]],
) -> None:
    """Fill in the correlations of one kind of error; part: 0 of the robot, 1 of the body."""
    chains: dict[tuple[str, str], dict[int, Placement]] = {}
    for i, place in enumerate(setup.placements[: setup.n_still]):
        if place.slow_noise is not None:
            chains.setdefault(key(place), {}).setdefault(int(error_index[i]), place)
    for chain in chains.values():
        index = np.array(list(chain))
        for axis in range(6):
            rows = 6 * index + axis
            sigma = setup.mocap_sigma[index, axis]
            R[np.ix_(rows, rows)] = _chain_correlation(list(chain.values()), sigma, part, axis)


def _chain_correlation(
    places: list[Placement], total_sigma: np.ndarray, part: int, axis: int
) -> np.ndarray:
    """Return the correlation (k, k) of the errors of one body and axis in k rests."""
    noises = [p.slow_noise for p in places if p.slow_noise is not None]
    sigma = np.array([n.sigma[part, axis] for n in noises])
    if not sigma.any():
        return np.eye(len(noises))
    duration_s = float(np.mean([n.duration_s for n in noises]))
    start_s = np.array([p.start_ns - places[0].start_ns for p in places]) / NS_PER_S
    distance_s = np.maximum(np.abs(start_s[:, None] - start_s), duration_s)
    share = np.minimum(sigma / total_sigma, 1.0)
    time_s = noises[0].time_s[part, axis]
    R = share[:, None] * share * mean_correlation(distance_s, duration_s, time_s)
    np.fill_diagonal(R, 1.0)
    values, vectors = np.linalg.eigh(R)
    return (vectors * np.maximum(values, MIN_EIGENVALUE)) @ vectors.T
