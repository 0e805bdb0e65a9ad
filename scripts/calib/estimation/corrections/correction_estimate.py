"""Estimated values of corrections with their σ, from the joint covariance."""

from dataclasses import dataclass

import numpy as np

from calib.estimation.corrections.base import EstimableCorrection
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult


@dataclass(frozen=True)
class CorrectionEstimate:
    """Values (q,) of a correction, SI, and their covariance (q, q) in units of the prior's σ."""

    correction: EstimableCorrection
    values: np.ndarray
    unit_covariance: np.ndarray

    @property
    def sigma_ratio(self) -> np.ndarray:
        """Return the σ (q,) over those of the prior: 1 where the data do not constrain a value."""
        return np.sqrt(np.diag(self.unit_covariance))

    @property
    def sigma(self) -> np.ndarray:
        """Return the σ (q,), SI."""
        return self.sigma_ratio * self.correction.prior_sigma

    @property
    def covariance(self) -> np.ndarray:
        """Return the covariance (q, q), SI."""
        sigma = self.correction.prior_sigma
        return self.unit_covariance * np.outer(sigma, sigma)


def correction_estimates(setup: Setup, result: EstimationResult) -> list[CorrectionEstimate]:
    """Return the estimates of all corrections of a Setup; none without a solution."""
    if result.solve_result is None:
        return []
    first = setup.n_chain_unknowns
    covariance = result.solve_result.covariance[first:, first:]
    values = result.state.correction_values
    return [
        CorrectionEstimate(correction, values[at], covariance[at, at])
        for correction, at in setup.correction_slices
    ]


def find_correction_estimate(
    setup: Setup, result: EstimationResult, name: str, subject: str
) -> CorrectionEstimate | None:
    """Return the estimate of the correction of that name and subject, or None without one."""
    return next(
        (
            estimate
            for estimate in correction_estimates(setup, result)
            if (estimate.correction.name, estimate.correction.subject) == (name, subject)
        ),
        None,
    )
