"""Errors that are not estimated but increase σ (consider covariance, Schmidt 1966)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.estimation.corrections.base import Correction
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.corrections.lidar.lidar_range_errors import (
    BEAM_RANGES,
    RangeBiasCorrection,
    make_range_corrections,
)
from calib.estimation.estimate_state import State
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.nlp.information_matrix import invert_information
from calib.estimation.nlp.measurement_factor import Factor, joint_information
from calib.estimation.noise.correlated_rests import with_correlated_rests
from calib.estimation.pose_chain import (
    deskew_group,
    model_with_corrections,
    prior_means_and_weights,
)
from calib.estimation.residuals.assignment import Assignment


def with_consider_covariance(setup: Setup, result: EstimationResult) -> EstimationResult:
    """Return the result with its information decreased by the errors that are not estimated, and by
    slow noise of motion capture that lasts from rest to rest."""
    if result.solve_result is None:
        return result
    result = with_correlated_rests(setup, result)
    H, (G, sigma) = result.solved.information, unestimated_couplings(setup, result)
    solved = result.solved
    loss = G @ np.linalg.solve(np.diag(sigma**-2.0) + G.T @ invert_information(H) @ G, G.T)
    return replace(result, solve_result=replace(solved, information=H - loss))


def unestimated_couplings(setup: Setup, result: EstimationResult) -> tuple[np.ndarray, np.ndarray]:
    """Return the couplings G (n, q) and σ (q,) of the errors that are not estimated.

    G: second derivatives of the cost by the n unknowns and the q parameters of these errors.
    """
    errors = unestimated_range_errors(setup, result.state)
    G = couple_corrections(
        setup,
        result.state,
        result.assignments,
        result.solved.factors,
        [correction for correction, _ in errors],
    )
    return G, np.array([sigma for _, sigma in errors])


def unestimated_variance(setup: Setup, result: EstimationResult) -> np.ndarray:
    """Return the variance (n,) that errors that are not estimated add to each unknown."""
    G, sigma = unestimated_couplings(setup, result)
    if not len(sigma):
        return np.zeros(setup.n_unknowns)
    weight = prior_means_and_weights(setup, result.state)[1]
    information = joint_information(result.solved.factors, weight)
    shift = invert_information(information) @ G * sigma
    return np.sum(shift**2, axis=1)


def unestimated_range_errors(setup: Setup, state: State) -> list[tuple[Correction, float]]:
    """Return (correction, σ) of the range error common to all beams of each lidar.

    Only where the errors of single beams are estimated and the common error is not: σ is that of
    the mean of so many errors of that size. Residuals hardly distinguish a common range error from
    a lidar farther away; if it were estimated, it would absorb other errors.
    """
    out: list[tuple[Correction, float]] = []
    for correction in make_range_corrections(setup):
        beams = setup.correction_slice(BEAM_RANGES, correction.subject)
        is_estimated = setup.correction_slice(correction.name, correction.subject) is not None
        if isinstance(correction, RangeBiasCorrection) and beams is not None and not is_estimated:
            theta = state.correction_values[beams]
            # The basis of θ is orthonormal: the squares are those of the errors of the beams.
            sigma = np.sqrt(np.sum(theta**2) / len(theta) / (len(theta) + 1))
            out.append((correction, sigma))
    return out


def common_range_sigmas(setup: Setup, state: State) -> dict[str, float]:
    """Return the σ, m, of the range error common to all beams, by lidar whose σ includes it."""
    errors = unestimated_range_errors(setup, state)
    return {correction.subject: float(sigma) for correction, sigma in errors}


def couple_corrections(
    setup: Setup,
    state: State,
    assignments: Sequence[Assignment],
    factors: Sequence[Factor],
    corrections: Sequence[Correction],
) -> np.ndarray:
    """Return second derivatives (n, q) of the cost by the unknowns and by the corrections.

    assignments, factors: of the groups of the setup, in order.
    """
    blocks = [np.zeros((setup.n_unknowns, 0))]
    for correction in corrections:
        G = np.zeros((setup.n_unknowns, correction.n_values))
        for group, assignment, factor in zip(setup.groups, assignments, factors, strict=True):
            if correction.affects(setup, group):
                deskewed = deskew_group(setup, state, group)
                model = model_with_corrections(setup, state, group)
                linearization = GroupLinearization(
                    setup, state, model, deskewed, assignment, factor.J_pose
                )
                derivative = correction.derivative(linearization)
                G[factor.columns] += factor.cross_information(derivative)
        blocks.append(G)
    return np.hstack(blocks)
