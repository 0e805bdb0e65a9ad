"""Results: one solution of the joint problem, and the settled estimate."""

from dataclasses import dataclass
from functools import cached_property
from typing import TypedDict

import numpy as np

from calib.estimation.estimate_state import State
from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.estimation.nlp.measurement_factor import Factor
from calib.estimation.residuals.assignment import Assignment


@dataclass(frozen=True)
class SolveResult:
    """One solution of the joint problem.

    factors: one per group, about the poses before the solution; information: (n, n) of all
    unknowns (right perturbations); cost: before the solution; status: what IPOPT returned.
    """

    factors: list[Factor]
    information: np.ndarray
    cost: float
    n_iterations: int
    status: str
    has_converged: bool

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (n, n) of all unknowns; see covariance_from_information."""
        return covariance_from_information(self.information)


class RoundRow(TypedDict):
    """One row of iterations.parquet."""

    round: int
    cost: float
    ipopt_iterations: int
    n_inliers: int
    step_m: float
    step_rad: float
    n_reassigned: int


@dataclass(frozen=True)
class EstimationResult:
    """The settled estimate.

    solve_result: the last solution, None if there was nothing to solve; assignments: the last, one
    per group; rounds: one row per round.
    """

    state: State
    solve_result: SolveResult | None
    assignments: list[Assignment]
    rounds: list[RoundRow]
    has_converged: bool

    @property
    def solved(self) -> SolveResult:
        """The last solution; raises ValueError if there was nothing to solve."""
        if self.solve_result is None:
            raise ValueError("nothing was solved")
        return self.solve_result
