"""Noise in two parts, what a cell repeats, and the factor on the noise of the motion capture."""

import numpy as np
import pytest

from calib.estimation.noise.noise_estimation import common_variance_share, update_mocap_factor
from calib.estimation.noise.noise_model import initial_noise
from calib.estimation.residuals.assignment import Assignment, Noise, number_repeat_groups

WHITE = Noise(1.0, 0.0)


def assignment(values, cell, trust=None, now=WHITE):
    """The Assignment of values (n, k) with a σ of 1 of their own."""
    n = len(values)
    return Assignment(
        candidate_feature=np.zeros(n, int),
        geometric_weight=np.ones(n) if trust is None else np.asarray(trust, float),
        repeat_group=np.asarray(cell),
        keypoint_sigma=np.ones(n),
        residual=np.asarray(values, float),
        range=np.ones(n),
        cos_incidence=np.ones(n),
        data=np.zeros((n, 3)),
        noise=now,
        gate_sigma=6.0,
    )


# --- what repeated measurements weigh


def test_measurements_with_nothing_in_common_weigh_one_each():
    found = assignment(np.zeros((6, 1)), [0, 0, 0, 1, 1, 2], now=Noise(2.0, 0.0))
    assert found.effective_weight == pytest.approx(np.ones(6))


def test_ten_measurements_with_all_in_common_weigh_one_together():
    found = assignment(np.zeros((10, 1)), np.zeros(10, int), now=Noise(0.0, 0.5))
    assert found.effective_weight.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("m", [1, 4, 25])
def test_the_mean_of_a_cell_has_the_variance_of_its_two_parts(m):
    """w = 3, c = 1: the variance of a mean of m is 1 + 9 / m, of one alone 10."""
    found = assignment(np.zeros((m, 1)), np.zeros(m, int), now=Noise(3.0, 1.0))
    assert found.effective_weight.sum() / found.noise.total**2 == pytest.approx(1 / (1 + 9 / m))


def test_a_measurement_fades_with_its_trust_and_leaves_without_a_step():
    now, cell = Noise(0.0, 1.0), np.zeros(5, int)
    with_it = assignment(np.zeros((5, 1)), cell, [1, 1, 1, 1, 1e-9], now).effective_weight
    without = assignment(np.zeros((4, 1)), cell[:4], None, now).effective_weight
    assert with_it[:4] == pytest.approx(without, rel=1e-8) and with_it[4] < 1e-9


def test_at_another_noise_the_gate_moves_along():
    found = assignment([[2.0], [5.0], [8.0]], [0, 1, 2])
    assert found.feature.tolist() == [0, 0, -1]
    assert found.with_noise(Noise(0.5, 0.0)).feature.tolist() == [0, -1, -1]
    assert found.with_noise(Noise(1.2, 1.6)).feature.tolist() == [0, 0, 0]


def test_cells_are_told_apart_by_every_part():
    rng = np.random.default_rng(0)
    parts = rng.integers(-3, 4, (3, 500))
    same = (parts[:, :, None] == parts[:, None, :]).all(0)
    number = number_repeat_groups(*parts)
    assert ((number[:, None] == number[None]) == same).all() and number.min() >= 0


# --- what the residuals show


def drawn(rng, n_cells, m, white, common, k=1):
    """Values (n, k) and cells (n,) with both parts of noise."""
    cell = np.repeat(np.arange(n_cells), m)
    values = common * rng.normal(size=(n_cells, k))[cell] + white * rng.normal(size=(len(cell), k))
    return values, cell


@pytest.mark.parametrize("white, common", [(1.0, 0.0), (1.0, 0.3), (0.3, 1.0), (0.0, 1.0)])
def test_the_share_in_common_is_found_without_bias(white, common):
    """Over 40 draws of 60 cells of 8."""
    draws = [drawn(np.random.default_rng(s), 60, 8, white, common) for s in range(40)]
    found = np.mean([common_variance_share(*d, 0.0) for d in draws])
    assert found == pytest.approx(common**2 / (white**2 + common**2), abs=0.02)


def test_what_the_estimate_took_out_of_the_means_is_put_back():
    """Twenty of sixty means made zero by as many unknowns; else c² would be a third less."""
    shares = {0.0: [], 20.0: []}
    for seed in range(40):
        values, cell = drawn(np.random.default_rng(seed), 60, 8, 0.5, 1.0)
        means = np.bincount(cell, values[:, 0]) / 8
        values = values - np.where(cell < 20, means[cell], 0)[:, None]
        for absorbed, found in shares.items():
            share = common_variance_share(values, cell, absorbed)
            found.append(share / (1 - share))
    assert np.mean(shares[20.0]) == pytest.approx(4.0, rel=0.1)
    assert np.mean(shares[0.0]) == pytest.approx(4.0 * 2 / 3, rel=0.1)


def test_measurements_that_nothing_repeats_have_no_share_in_common():
    assert common_variance_share(np.ones((5, 2)), np.arange(5), 0.0) == 0


def test_the_steps_of_a_scan_pattern_are_common_from_the_start():
    assert initial_noise("board_outline", 10.0) == Noise(0.0, 1.0)
    assert initial_noise("target_surface", 10.0) == Noise(10.0, 0.0)


# --- the motion capture


def test_mcs_errors_as_large_as_stated_leave_the_factor_at_one_in_99_of_100_cases():
    rng = np.random.default_rng(0)
    factors = [
        update_mocap_factor(rng.normal(size=(8, 6)), np.ones((8, 6)), 1.0) for _ in range(2000)
    ]
    assert 0.985 < np.mean(np.array(factors) == 1.0) < 0.995


def test_mcs_errors_five_times_as_large_raise_the_factor_towards_five():
    rng = np.random.default_rng(1)
    factor, y = 1.0, 5 * rng.normal(size=(20, 6))
    for _ in range(20):
        factor = update_mocap_factor(y / factor, np.ones((20, 6)), factor)
    assert 3.5 < factor < 5.5


def test_errors_that_the_data_do_not_tell_say_nothing_of_the_motion_capture():
    assert update_mocap_factor(np.full((4, 6), 3.0), np.full((4, 6), 0.01), 1.7) == 1.7
