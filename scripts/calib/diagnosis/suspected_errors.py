"""Suspected errors of targets and sensors, from the residuals of a converged estimate.

Every candidate correction is put to a score test (score_test.py). The best one is accepted first,
then the others are tested beside it: what no longer explains anything described the same error.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from calib.diagnosis.observability import LEVER_ARM_M
from calib.diagnosis.score_terms import Candidate, list_candidates, make_noise_terms
from calib.estimation.corrections.base import TestableCorrection
from calib.estimation.corrections.score_test import (
    NoiseTerm,
    ScoreStep,
    ScoreSystem,
    cluster_scatter,
    fit_score_step,
    gain_p_value,
)
from calib.estimation.corrections.slips_and_bumps import SESSION_SHIFT_NAMES
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult

P_CONSIDER = 1e-3  # p-value below which a correction is considered
MAX_SUSPECTED_ERRORS = 6  # accepted beside each other
# Share of the best gain from which another correction may be the true one.
MIN_ALTERNATIVE_GAIN_RATIO = 0.5
MIN_GAIN_PER_PARAMETER = 3.0  # log-likelihood gain that each further parameter must bring


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
class AcceptedError:
    """An accepted candidate, the step without it, and the scores of it and its alternatives."""

    index: int
    step_without: ScoreStep
    scores: Scores


@dataclass(frozen=True)
class _ScoreTests:
    """The candidates and the terms of their score tests."""

    candidates: list[Candidate]
    terms: dict[str, NoiseTerm]

    def step(self, indices: Sequence[int]) -> ScoreStep:
        """Return the step with the parameters of some candidates free."""
        columns = [self.candidates[i].columns for i in indices]
        return fit_score_step(self.terms, np.concatenate([np.zeros(0, int), *columns]))

    def scores_beside(self, current: ScoreStep) -> Scores:
        """Score the candidates that, beside those free in a step, explain more than chance."""
        system, out = ScoreSystem(self.terms, current.variance_factors), {}
        current_drop = system.cost_drop(current.free_index)
        for i, (_, columns) in enumerate(self.candidates):
            free = np.concatenate([current.free_index, columns])
            drop = system.cost_drop(free) - current_drop
            is_free = np.isin(columns, current.free_index).any()
            if is_free or gain_p_value(drop, len(columns)) > P_CONSIDER:
                continue
            step = fit_score_step(self.terms, free)
            scatter = cluster_scatter(self.terms, step, columns)
            gain = (step.log_likelihood - current.log_likelihood) / scatter
            if gain_p_value(gain, len(columns)) < P_CONSIDER:
                out[i] = ScoredCorrection(step, gain, scatter)
        return out

    def best(self, scores: Scores) -> int:
        """Return the candidate that explains the most for its number of parameters.

        A target or sensor that moved within a session is preferred only if no permanent error
        explains at least half as much.
        """
        largest = max(score.gain for score in scores.values())
        permanent = [
            i
            for i, score in scores.items()
            if self.candidates[i].correction.name not in SESSION_SHIFT_NAMES
            and score.gain >= MIN_ALTERNATIVE_GAIN_RATIO * largest
        ]
        return max(
            permanent or scores,
            key=lambda i: scores[i].gain - MIN_GAIN_PER_PARAMETER * len(self.candidates[i].columns),
        )

    def beside_others(self, chosen: list[int], index: int) -> AcceptedError:
        """Score a chosen candidate and its alternatives beside the other chosen ones."""
        step = self.step([i for i in chosen if i != index])
        scores = self.scores_beside(step)
        minimum = MIN_ALTERNATIVE_GAIN_RATIO * scores[index].gain if index in scores else np.inf
        return AcceptedError(
            index, step, {i: score for i, score in scores.items() if score.gain >= minimum}
        )


def find_suspected_errors(
    setup: Setup, result: EstimationResult, corrections: Sequence[TestableCorrection]
) -> list[dict[str, Any]]:
    """Return the suspected errors as in solution.json, those that move a pose the most first.

    setup: of still placements only, as moving views have errors of their own. corrections: to test.

    Each has name, subject, description, remedy; estimate and sigma of its parameters (m, rad, px or
    1); log_likelihood_gain and p_value; explained_share of the squared residuals by noise;
    pose_shift by sensor {m, rad, sigmas} if only this error is corrected, in the σ after it; and
    alternatives, the other corrections that would do instead.
    """
    if result.solve_result is None:
        return []
    candidates = list_candidates(corrections)
    tests = _ScoreTests(candidates, make_noise_terms(setup, result, candidates))
    sensors = sorted(setup.models)
    out = [_suspected_error_json(tests, sensors, error) for error in _accept_errors(tests)]
    remedies = {error["remedy"] for error in out}
    for error in out:
        others = remedies - {error["remedy"]}
        error["alternatives"] = [a for a in error["alternatives"] if a["remedy"] not in others]
    return sorted(out, key=_pose_impact_m, reverse=True)


def _accept_errors(tests: _ScoreTests) -> list[AcceptedError]:
    """Accept the best candidate, then others beside it as long as they explain more than chance.

    Candidates that later ones have made superfluous are removed, or replaced by an alternative.
    """
    chosen: list[int] = []
    while len(chosen) < MAX_SUSPECTED_ERRORS:
        scores = tests.scores_beside(tests.step(chosen))
        if not scores:
            break
        chosen.append(tests.best(scores))
    for _ in range(MAX_SUSPECTED_ERRORS):
        errors = [tests.beside_others(chosen, i) for i in chosen]
        revised = list(dict.fromkeys(tests.best(e.scores) for e in errors if e.scores))
        if revised == chosen:
            break
        chosen = revised
    errors = [tests.beside_others(chosen, i) for i in chosen]
    return [e for e in errors if e.index in e.scores]


def _suspected_error_json(
    tests: _ScoreTests, sensors: list[str], error: AcceptedError
) -> dict[str, Any]:
    correction, columns = tests.candidates[error.index]
    score = error.scores[error.index]
    alternatives = [
        i
        for i in sorted(error.scores, key=lambda i: -error.scores[i].gain)
        if not _is_same_error(tests.candidates[i].correction, correction)
    ]
    return _scored_correction_json(tests.candidates[error.index], score) | {
        "p_value": gain_p_value(score.gain, len(columns)),
        "explained_share": {
            noise: 1 - score.step.squares_after[noise] / squares
            for noise, squares in error.step_without.squares_after.items()
            if squares > 0
        },
        "pose_shift": _pose_shifts_json(sensors, tests.step([]), tests.step([error.index])),
        "alternatives": [
            _scored_correction_json(tests.candidates[i], error.scores[i]) for i in alternatives
        ],
    }


def _is_same_error(a: TestableCorrection, b: TestableCorrection) -> bool:
    return (a.name, a.subject) == (b.name, b.subject)


def _pose_impact_m(error: dict[str, Any]) -> float:
    """Return how far, m, correcting an error moves a point at LEVER_ARM_M from a sensor."""
    return max(s["m"] + LEVER_ARM_M * s["rad"] for s in error["pose_shift"].values())


def _pose_shifts_json(
    sensors: list[str], before: ScoreStep, after: ScoreStep
) -> dict[str, dict[str, float]]:
    """Return by how much each pose changes between steps: m, rad, and sigmas.

    sigmas: the largest of the six components, in the σ after the second step.
    """
    rows = np.arange(6 * len(sensors))
    shifts = (after.x - before.x)[rows].reshape(-1, 6)
    covariance = after.system.covariance(after.free_index, rows)[1]
    sigmas = np.sqrt(np.diag(covariance)).reshape(-1, 6)
    return {
        name: {
            "m": float(np.linalg.norm(shift[:3])),
            "rad": float(np.linalg.norm(shift[3:])),
            "sigmas": float((np.abs(shift) / sigma).max()),
        }
        for name, shift, sigma in zip(sensors, shifts, sigmas, strict=True)
    }


def _scored_correction_json(candidate: Candidate, score: ScoredCorrection) -> dict[str, Any]:
    correction, columns = candidate
    step = score.step
    values = step.correction_values[columns]
    covariance = step.system.covariance(step.free_index, np.zeros(0, int))[0]
    sigma = np.sqrt(score.scatter * np.diag(covariance)[np.isin(step.free_index, columns)])
    return {
        "name": correction.name,
        "subject": correction.subject,
        "description": correction.describe(values, sigma),
        "remedy": correction.remedy,
        "estimate": values.tolist(),
        "sigma": sigma.tolist(),
        "log_likelihood_gain": score.gain,
    }
