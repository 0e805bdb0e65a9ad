"""Errors that nobody estimates, but that σ must know of (Schmidt 1966: consider covariance)."""

from dataclasses import replace

import numpy as np

from calib.estimation import pose_chain
from calib.estimation.corrections import sensor_errors
from calib.estimation.corrections.correction import View
from calib.estimation.nlp.information_matrix import inverse
from calib.estimation.nlp.measurement_factor import information


def widened(setup, result):
    """The Result with an information matrix that knows of the errors that nobody estimates."""
    if result.solution is None:
        return result
    H, (G, sigma) = result.solution.information, told(setup, result)
    less = G @ np.linalg.solve(np.diag(sigma**-2.0) + G.T @ inverse(H) @ G, G.T)
    return replace(result, solution=replace(result.solution, information=H - less))


def told(setup, result):
    """(G (n, q), σ (q,)) of the errors that nobody estimates: second derivatives of the cost by the
    unknowns and by them, and how large they may be."""
    found = errors(setup, result.state)
    given = setup, result.state, result.assigned, result.solution.parts
    couplings = [np.zeros((setup.n, 0)), *(coupling(*given, h) for h, _ in found)]
    return np.hstack(couplings), np.array([sigma for _, sigma in found])


def variance(setup, result):
    """(n,) what errors that nobody estimates add to the variances of the unknowns."""
    G, sigma = told(setup, result)
    if not len(sigma):
        return np.zeros(setup.n)
    weight = pose_chain.priors(setup, result.state)[1]
    follows = inverse(information(result.solution.parts, weight)) @ G * sigma
    return np.sum(follows**2, axis=1)


def errors(setup, state):
    """[(Hypothesis, σ)] of what the beams of a lidar may be off by in common, where they were found
    to err one by one and that is not estimated.

    By as much as chance makes of so many errors of that size. Residuals hardly tell it from a lidar
    farther back: estimated, it would follow whatever else is wrong.
    """
    out = []
    for h in sensor_errors.ranges(setup):
        at = setup.span("beams", h.of)
        if h.name == "range_bias" and at is not None and setup.span(h.name, h.of) is None:
            theta = state.theta[at]
            # The basis of θ is orthonormal: its squares are those of the errors themselves.
            out.append((h, np.sqrt(np.sum(theta**2) / len(theta) / (len(theta) + 1))))
    return out


def coupling(setup, state, assigned, parts, hypothesis):
    """(n, q): second derivatives of the cost by the unknowns and the numbers of a Hypothesis."""
    G = np.zeros((setup.n, hypothesis.size))
    for g, a, part in zip(setup.groups, assigned, parts, strict=True):
        if hypothesis.touches(setup, g):
            seen, model = pose_chain.frozen(setup, state, g), pose_chain.model(setup, state, g)
            view = View(setup, state, model, seen, a, part.J)
            G[part.columns] += part.by_unknowns(hypothesis.derivative(view))
    return G
