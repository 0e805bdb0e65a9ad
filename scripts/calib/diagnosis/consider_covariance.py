"""Errors that nobody estimates, but that σ must know of (Schmidt 1966: consider covariance)."""

from dataclasses import replace

import numpy as np

from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.corrections.lidar_range_errors import (
    BEAM_RANGES,
    RangeBiasCorrection,
    make_range_corrections,
)
from calib.estimation.nlp.information_matrix import invert_information
from calib.estimation.nlp.measurement_factor import joint_information
from calib.estimation.pose_chain import (
    deskew_group,
    model_with_corrections,
    prior_means_and_weights,
)


def with_consider_covariance(setup, result):
    """The Result with an information matrix that knows of the errors that nobody estimates."""
    if result.solve_result is None:
        return result
    H, (G, sigma) = result.solve_result.information, unestimated_couplings(setup, result)
    less = G @ np.linalg.solve(np.diag(sigma**-2.0) + G.T @ invert_information(H) @ G, G.T)
    return replace(result, solve_result=replace(result.solve_result, information=H - less))


def unestimated_couplings(setup, result):
    """(G (n, q), σ (q,)) of the errors that nobody estimates: second derivatives of the cost by the
    unknowns and by them, and how large they may be."""
    found = unestimated_range_errors(setup, result.state)
    given = setup, result.state, result.assignments, result.solve_result.factors
    couplings = [np.zeros((setup.n_unknowns, 0)), *(couple_correction(*given, h) for h, _ in found)]
    return np.hstack(couplings), np.array([sigma for _, sigma in found])


def unestimated_variance(setup, result):
    """(n,) what errors that nobody estimates add to the variances of the unknowns."""
    G, sigma = unestimated_couplings(setup, result)
    if not len(sigma):
        return np.zeros(setup.n_unknowns)
    weight = prior_means_and_weights(setup, result.state)[1]
    follows = invert_information(joint_information(result.solve_result.factors, weight)) @ G * sigma
    return np.sum(follows**2, axis=1)


def unestimated_range_errors(setup, state):
    """[(Hypothesis, σ)] of what the beams of a lidar may be off by in common, where they were found
    to err one by one and that is not estimated.

    By as much as chance makes of so many errors of that size. Residuals hardly tell it from a lidar
    farther back: estimated, it would follow whatever else is wrong.
    """
    out = []
    for h in make_range_corrections(setup):
        at = setup.correction_slice(BEAM_RANGES, h.subject)
        if (
            isinstance(h, RangeBiasCorrection)
            and at is not None
            and setup.correction_slice(h.name, h.subject) is None
        ):
            theta = state.correction_values[at]
            # The basis of θ is orthonormal: its squares are those of the errors themselves.
            out.append((h, np.sqrt(np.sum(theta**2) / len(theta) / (len(theta) + 1))))
    return out


def common_range_sigmas(setup, state) -> dict[str, float]:
    """Return the σ, m, of the range error common to all beams by lidar, where σ of the pose has it."""
    return {h.subject: float(sigma) for h, sigma in unestimated_range_errors(setup, state)}


def couple_correction(setup, state, assigned, parts, hypothesis):
    """(n, q): second derivatives of the cost by the unknowns and the numbers of a Hypothesis."""
    G = np.zeros((setup.n_unknowns, hypothesis.n_values))
    for g, a, part in zip(setup.groups, assigned, parts, strict=True):
        if hypothesis.affects(setup, g):
            seen, model = deskew_group(setup, state, g), model_with_corrections(setup, state, g)
            view = GroupLinearization(setup, state, model, seen, a, part.J_pose)
            G[part.columns] += part.cross_information(hypothesis.derivative(view))
    return G
