"""Tails of residuals are judged on their own robust scale."""

import numpy as np
import pytest

from calib.diagnosis.residual_statistics import tail_share

RNG = np.random.default_rng(0)
NORMAL = np.abs(RNG.normal(size=100_000))


def test_normal_residuals_have_a_quarter_percent_beyond_3_sigma():
    assert tail_share(NORMAL) == pytest.approx(0.0027, abs=0.0005)


def test_views_of_which_half_scatter_twice_as_much_have_no_tail():
    """By the median their σ is 1.3, and 2.5 % lie beyond 3 σ."""
    mixed = np.where(RNG.random(NORMAL.size) < 0.5, 2.0, 1.0) * NORMAL
    by_median = mixed / (1.4826 * np.median(mixed))
    assert np.mean(by_median > 3) > 0.02
    assert tail_share(by_median) < 0.015


@pytest.mark.parametrize("share", [0.05, 0.1, 0.15])
def test_outliers_at_5_sigma_are_a_tail(share):
    spoiled = np.where(RNG.random(NORMAL.size) < share, 5.5, NORMAL)
    assert tail_share(spoiled) == pytest.approx(share, abs=0.01)


def test_no_residual_has_no_tail():
    assert tail_share(np.zeros(0)) == 0.0
