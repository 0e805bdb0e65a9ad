"""Score tests of candidate corrections, each beside others whose parameters are free too."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.diagnosis.error_search.score_terms import Candidate
from calib.estimation.corrections.score_test import (
    NoiseTerm,
    ScoreStep,
    ScoreSystem,
    cluster_scatter,
    fit_score_step,
    gain_p_value,
)

P_CONSIDER = 1e-3  # p-value below which a correction is considered
P_SCREEN = 0.05  # the same with the noise as it is, before the noise follows the correction


class ScoredCorrection(NamedTuple):
    """A correction that explains more than chance.

    step: with its parameters free. gain: in log likelihood, divided by scatter, the variance of
    the scores of whole placements over what their information gives.
    """

    step: ScoreStep
    gain: float
    scatter: float


Scores = dict[int, ScoredCorrection]  # by index of the candidate


@dataclass(frozen=True)
class ScoreTests:
    """The candidates and the terms of their score tests."""

    candidates: list[Candidate]
    terms: dict[str, NoiseTerm]

    def columns(self, indices: Iterable[int]) -> np.ndarray:
        """Return the parameters of some candidates, by increasing index of the candidate."""
        parts = [self.candidates[i].columns for i in sorted(indices)]
        return np.concatenate([np.zeros(0, int), *parts])

    def step(self, indices: Iterable[int]) -> ScoreStep:
        """Return the step with the parameters of some candidates free."""
        return fit_score_step(self.terms, self.columns(indices))

    def scores_beside(self, current: ScoreStep) -> Scores:
        """Score the candidates that, beside those free in a step, explain more than chance."""
        system, out = ScoreSystem(self.terms, current.variance_factors), {}
        current_drop = system.cost_drop(current.free_index)
        for i, (_, columns) in enumerate(self.candidates):
            free = np.concatenate([current.free_index, columns])
            drop = system.cost_drop(free) - current_drop
            is_free = np.isin(columns, current.free_index).any()
            if is_free or gain_p_value(drop, len(columns)) > P_SCREEN:
                continue
            step = fit_score_step(self.terms, free)
            if self._leaves_linear_range(step):
                continue
            scatter = cluster_scatter(self.terms, step, columns)
            gain = (step.log_likelihood - current.log_likelihood) / scatter
            if gain_p_value(gain, len(columns)) < P_CONSIDER:
                out[i] = ScoredCorrection(step, gain, scatter)
        return out

    def _leaves_linear_range(self, step: ScoreStep) -> bool:
        """Return whether a value is larger than its derivatives allow.

        Sizes of all kinds that are free together, for example, can shrink to nothing.
        """
        return any(
            np.isin(columns, step.free_index).all()
            and np.abs(step.correction_values[columns]).max() > correction.max_size
            for correction, columns in self.candidates
        )
