"""What corner residuals repeat: lens, board, or nothing but a noise that differs between views."""

import numpy as np
import pytest

from calib.estimation.noise.placement_noise import excess_spread
from calib.estimation.noise.repeated_residuals import CornerResiduals, repeated_shares

SIZE_PX = (1600, 1200)
N_PLACEMENTS, N_CORNERS = 15, 24
NOISE_PX = 0.3


def draw_corners(seed, lens_px=0.0, board_px=0.0, noise_px=NOISE_PX):
    """Corners of a board 500 px wide, anywhere in the image; lens and board errors are fixed."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(6), np.arange(4)), -1).reshape(-1, 2) * 100.0
    warp = board_px * rng.normal(size=(N_CORNERS, 2))
    parts = []
    for placement in range(N_PLACEMENTS):
        uv = grid + rng.uniform([0, 0], [1050, 850])
        bent = lens_px * np.sqrt(2) * np.sin(uv / 120)
        sigma = np.broadcast_to(noise_px, N_PLACEMENTS)[placement]
        residual = bent + warp + sigma * rng.normal(size=uv.shape)
        parts.append((residual, np.full(N_CORNERS, placement), np.arange(N_CORNERS), uv))
    return CornerResiduals(*(np.concatenate(p) for p in zip(*parts, strict=True)))


@pytest.mark.parametrize("seed", range(20))
def test_independent_noise_repeats_nowhere_and_is_alike_in_all_placements(seed):
    assert repeated_shares(draw_corners(seed), SIZE_PX) == (0.0, 0.0, 0.0)


def test_a_lens_error_of_the_size_of_the_noise_repeats_in_the_image_only():
    image, target, _ = repeated_shares(draw_corners(0, lens_px=0.3), SIZE_PX)
    assert 0.25 < image < 0.6  # half of the variance, less what a cell averages
    assert target == 0.0


def test_a_board_error_of_the_size_of_the_noise_repeats_on_the_board_only():
    image, target, _ = repeated_shares(draw_corners(0, board_px=0.3), SIZE_PX)
    assert image == 0.0
    assert target == pytest.approx(0.5, abs=0.15)


def test_three_blurred_placements_differ_from_the_others_by_more_than_chance():
    noise = np.full(N_PLACEMENTS, NOISE_PX)
    noise[:3] *= 3
    shares = repeated_shares(draw_corners(0, noise_px=noise), SIZE_PX)
    assert (shares.image, shares.target) == (0.0, 0.0)
    assert 0.3 < shares.views < 0.8  # log 3 in a fifth of the placements: 0.44


def test_equal_noise_has_an_excess_spread_of_zero_in_nearly_all_draws():
    rng = np.random.default_rng(1)
    dof = np.full(15, 42.0)
    spreads = [excess_spread(rng.chisquare(dof) / dof, dof) for _ in range(500)]
    assert np.mean(np.array(spreads) > 0) < 0.025


def test_two_placements_tell_no_spread():
    assert excess_spread(np.array([1.0, 100.0]), np.array([40.0, 40.0])) == 0.0
