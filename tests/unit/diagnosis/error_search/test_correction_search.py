"""The search for a set of corrections loses nothing that it had found, and ends."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.diagnosis.error_search.candidate_scores import ScoreTests
from calib.diagnosis.error_search.correction_search import accept_errors
from calib.diagnosis.error_search.score_terms import Candidate
from calib.estimation.corrections.score_test import NoiseTerm, ScoreBlock

N_RESIDUALS, N_PLACEMENTS, N_CANDIDATES = 400, 20, 5
UNLIMITED = {"subject": "s", "min_lead": -np.inf, "max_size": np.inf}
TRUE_VALUE = 0.05  # in a residual of σ 1 by 10 to 20 for each 1: about 10 σ of the value

# Seeds of problems, by the number of true errors and how alike candidates are, in which a search
# that revised all choices at once ended without some that explain more than chance.
LOST_AT_ONCE = [(135, 2, 1.0), (155, 3, 1.0), (20, 4, 1.0), (138, 2, 2.0), (130, 3, 2.0)]


def residuals_and_slopes(seed, n_true, likeness):
    """Residuals (n,) of unit noise in which n_true errors stand, and slopes (n, 5)."""
    rng = np.random.default_rng(seed)
    base = rng.normal(size=(N_RESIDUALS, N_CANDIDATES))
    mixing = rng.normal(size=(N_CANDIDATES, N_CANDIDATES)) / np.sqrt(N_CANDIDATES)
    slopes = 10 * base @ (np.eye(N_CANDIDATES) + likeness * mixing)
    truth = np.zeros(N_CANDIDATES)
    truth[:n_true] = rng.choice([-1, 1], n_true) * TRUE_VALUE
    return -slopes @ truth + rng.normal(size=N_RESIDUALS), slopes


def score_tests(residuals, slopes, names=None):
    """ScoreTests of one value for each column of slopes, beside one unknown that moves nothing."""
    p = slopes.shape[1]
    blocks = [
        ScoreBlock(
            cluster=k,
            columns=np.array([0]),
            correction_index=np.arange(p),
            H=np.ones((1, 1)),
            G=np.zeros((1, p)),
            K=slopes[rows].T @ slopes[rows],
            gradient=np.zeros(1),
            score=slopes[rows].T @ residuals[rows],
            squared_residuals=float(residuals[rows] @ residuals[rows]),
            n_terms=float(len(rows)),
        )
        for k, rows in enumerate(np.array_split(np.arange(len(residuals)), N_PLACEMENTS))
    ]
    names = names or [f"error_{i}" for i in range(p)]
    candidates = [
        Candidate(SimpleNamespace(name=name, **UNLIMITED), np.array([i]))
        for i, name in enumerate(names)
    ]
    return ScoreTests(candidates, {"noise": NoiseTerm(blocks, 1, p, 1e-4)})


@pytest.mark.parametrize(("seed", "n_true", "likeness"), LOST_AT_ONCE)
def test_nothing_that_explains_more_than_chance_is_left_beside_what_is_accepted(
    seed, n_true, likeness
):
    tests = score_tests(*residuals_and_slopes(seed, n_true, likeness))
    accepted = [error.index for error in accept_errors(tests)]
    assert tests.scores_beside(tests.step(accepted)) == {}
    assert all(error.index in error.scores for error in accept_errors(tests))


@pytest.mark.parametrize("seed", [130, 138])
def test_as_likely_as_the_true_errors_themselves(seed):
    """The accepted explain, within 8 in log likelihood, what the true errors explain."""
    n_true = 2 if seed == 138 else 3
    tests = score_tests(*residuals_and_slopes(seed, n_true, 2.0))
    accepted = [error.index for error in accept_errors(tests)]
    true_step = tests.step(range(n_true))
    assert tests.step(accepted).log_likelihood > true_step.log_likelihood - 8


def test_a_mixture_taken_first_gives_way_to_the_two_errors_that_it_mixes():
    rng = np.random.default_rng(0)
    slopes = 10 * rng.normal(size=(N_RESIDUALS, 3))
    slopes[:, 2] = slopes[:, 0] + slopes[:, 1] + slopes[:, 2]
    residuals = -slopes[:, :2] @ [0.05, 0.05] + rng.normal(size=N_RESIDUALS)
    assert [error.index for error in accept_errors(score_tests(residuals, slopes))] == [0, 1]


def test_of_noise_nothing_is_accepted():
    _, slopes = residuals_and_slopes(0, 2, 1.0)
    residuals = np.random.default_rng(1).normal(size=N_RESIDUALS)
    assert accept_errors(score_tests(residuals, slopes)) == []


def test_the_order_of_the_candidates_does_not_matter():
    residuals, slopes = residuals_and_slopes(155, 3, 1.0)
    accepted = {e.index for e in accept_errors(score_tests(residuals, slopes))}
    reverse = {4 - e.index for e in accept_errors(score_tests(residuals, slopes[:, ::-1]))}
    assert accepted == reverse


def test_a_knock_that_explains_a_little_more_than_a_permanent_error_is_its_alternative():
    rng = np.random.default_rng(0)
    slopes = 10 * rng.normal(size=(N_RESIDUALS, 2))
    slopes[:, 1] = slopes[:, 0] + 0.3 * slopes[:, 1]
    residuals = -slopes[:, 0] * 0.03 + rng.normal(size=N_RESIDUALS)
    tests = score_tests(residuals, slopes, ["radius", "target_slip"])
    (error,) = accept_errors(tests)
    assert error.index == 0 and set(error.scores) == {0, 1}
