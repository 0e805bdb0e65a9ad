"""Results: one solution of the joint problem, and the settled estimate."""

from dataclasses import dataclass, replace
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
    unknowns (right perturbations); cost: before the solution; status: what IPOPT returned;
    added_pose_covariance: (m, m) of the sensors and mounts, what the model does not know of.
    """

    factors: list[Factor]
    information: np.ndarray
    cost: float
    n_iterations: int
    status: str
    has_converged: bool
    added_pose_covariance: np.ndarray | None = None

    @cached_property
    def model_covariance(self) -> np.ndarray:
        """Covariance (n, n) of all unknowns by the model; see covariance_from_information."""
        return covariance_from_information(self.information)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (n, n) of all unknowns, with what was added to that of the model."""
        if self.added_pose_covariance is None:
            return self.model_covariance
        out, m = self.model_covariance.copy(), len(self.added_pose_covariance)
        out[:m, :m] += self.added_pose_covariance
        return out

    @property
    def variance_growth(self) -> np.ndarray:
        """Factors (n,) on the variances of the model, 1 where nothing was added."""
        before, after = np.diag(self.model_covariance), np.diag(self.covariance)
        return np.where(before > 0, after / np.where(before > 0, before, 1.0), 1.0)


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

    def with_added_covariance(self, covariance: np.ndarray) -> "EstimationResult":
        """Return the result with a covariance (m, m) added to its sensor poses and mounts."""
        before = self.solved.added_pose_covariance
        added = covariance if before is None else before + covariance
        return replace(self, solve_result=replace(self.solved, added_pose_covariance=added))
