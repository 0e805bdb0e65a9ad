"""Errors that nobody estimates, but that σ must know of (Schmidt 1966: consider covariance)."""

from dataclasses import replace

import numpy as np

from calib import chain
from calib.hypotheses import of_sensors
from calib.hypothesis import View
from calib.information import inverse


def widened(setup, result):
    """The Result with an information matrix that knows of what the beams of a lidar may be off by
    in common, where they were found to err one by one and that is not estimated.

    By as much as chance makes of so many errors of that size. Residuals hardly tell it from a lidar
    farther back: estimated, it would follow whatever else is wrong.
    """
    if result.solution is None:
        return result
    couplings, sigma = [np.zeros((setup.n, 0))], []
    for h in of_sensors.ranges(setup):
        at = setup.span("beams", h.of)
        if h.name == "range_bias" and at is not None and setup.span(h.name, h.of) is None:
            theta = result.state.theta[at]
            # The basis of θ is orthonormal: its squares are those of the errors themselves.
            sigma.append(np.sqrt(np.sum(theta**2) / len(theta) / (len(theta) + 1)))
            couplings.append(coupling(setup, result, h))
    information = _without(result.solution.information, np.hstack(couplings), np.array(sigma))
    return replace(result, solution=replace(result.solution, information=information))


def coupling(setup, result, hypothesis):
    """(n, q): second derivatives of the cost by the unknowns and the numbers of a Hypothesis."""
    G = np.zeros((setup.n, hypothesis.size))
    for g, a, part in zip(setup.groups, result.assigned, result.solution.parts, strict=True):
        if hypothesis.touches(setup, g):
            seen, model = chain.frozen(setup, result.state, g), chain.model(setup, result.state, g)
            view = View(setup, result.state, model, seen, a, part.J)
            G[part.columns] += part.by_unknowns(hypothesis.derivative(view))
    return G


def _without(H, G, sigma):
    """(n, n): the inverse of H⁻¹ + K Σ² Kᵀ, K = -H⁻¹ G being how the unknowns follow numbers of
    those σ (q,)."""
    return H - G @ np.linalg.solve(np.diag(sigma**-2.0) + G.T @ inverse(H) @ G, G.T)
