"""Suspected errors of targets and sensors, from the residuals of a converged estimate.

Every candidate correction is put to a score test (score_test.py). A search finds the set of them
that explains the residuals (error_search): what explains nothing beside the others describes the
same error.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.diagnosis.error_search.candidate_scores import ScoredCorrection, ScoreTests
from calib.diagnosis.error_search.correction_search import AcceptedError, accept_errors
from calib.diagnosis.error_search.score_terms import Candidate, list_candidates, make_noise_terms
from calib.diagnosis.observability import LEVER_ARM_M
from calib.estimation.corrections.base import TestableCorrection
from calib.estimation.corrections.score_test import ScoreStep, gain_p_value
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult


def find_suspected_errors(
    setup: Setup, result: EstimationResult, corrections: Sequence[TestableCorrection]
) -> list[dict[str, Any]]:
    """Return the suspected errors as in solution.json, those that move a pose the most first.

    setup: of still placements only, as moving views have errors of their own. corrections: to test.

    Each has name, subject, description, remedy, change of the config; estimate and sigma of its
    parameters (m, rad, px or 1); log_likelihood_gain and p_value; explained_share of the squared
    residuals by noise; pose_shift by sensor {m, rad, shift (6,), sigmas} if only this error is
    corrected, in the σ after it; and alternatives, the other corrections that would do instead.
    """
    if result.solve_result is None:
        return []
    candidates = list_candidates(corrections)
    tests = ScoreTests(candidates, make_noise_terms(setup, result, candidates))
    sensors = sorted(setup.models)
    out = [_suspected_error_json(tests, sensors, error) for error in accept_errors(tests)]
    remedies = {error["remedy"] for error in out}
    for error in out:
        others = remedies - {error["remedy"]}
        error["alternatives"] = [a for a in error["alternatives"] if a["remedy"] not in others]
    return sorted(out, key=_pose_impact_m, reverse=True)


def _suspected_error_json(
    tests: ScoreTests, sensors: list[str], error: AcceptedError
) -> dict[str, Any]:
    correction, columns = tests.candidates[error.index]
    score = error.score
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
    """Return by how much each pose changes between steps: m, rad, shift (6,) and sigmas.

    shift: right perturbation, m and rad. sigmas: its largest component, in the σ after the second
    step.
    """
    rows = np.arange(6 * len(sensors))
    shifts = (after.x - before.x)[rows].reshape(-1, 6)
    covariance = after.system.covariance(after.free_index, rows)[1]
    sigmas = np.sqrt(np.diag(covariance)).reshape(-1, 6)
    return {
        name: {
            "m": float(np.linalg.norm(shift[:3])),
            "rad": float(np.linalg.norm(shift[3:])),
            "shift": shift.tolist(),
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
        "change": correction.config_change(values),
        "estimate": values.tolist(),
        "sigma": sigma.tolist(),
        "log_likelihood_gain": score.gain,
    }
