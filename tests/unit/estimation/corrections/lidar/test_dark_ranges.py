"""Ranges that depend on what is hit: what dark squares add is found, and the pose is right."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.correction_selection import estimate_with_corrections
from calib.estimation.corrections.correction_estimate import find_correction_estimate
from calib.estimation.estimation_problem import Setup
from calib.geometry.se3 import invert_pose, se3_exp, se3_log
from helpers import synthetic_setup
from helpers.synthetic_setup import SyntheticWorld, make_synthetic_setup

BOARDS = [("board", None)] * 7 + [("cylinder", None)] * 3
LIMITS = {
    "max_rounds": 30,
    "tolerance_m": 1e-6,
    "tolerance_rad": 1e-6,
    "initial_noise_factor": 100.0,
}
START = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in synthetic_setup.TRUE_POSES.items()}
SHORT_M = -0.012


def setup_of(world, first_square=None, *, leaves_out=False, seed=0):
    """The Setup of measurements of a world, whose board's config says so much of its colours."""
    made = make_synthetic_setup(seed, BOARDS, world)
    board = made.targets["board"]
    pattern = replace(board.pattern, first_square_color=first_square)
    board = replace(board, pattern=pattern, leaves_out_pattern=leaves_out)
    return replace(made, targets=made.targets | {"board": board})


def refine(made: Setup, wanted="auto"):
    return estimate_with_corrections(made, START, {"lidar_corrections": wanted}, **LIMITS)


def lidar_error_in_sigma(made, result):
    """Largest of the six components of the lidar's error, in its σ."""
    off = se3_log(
        invert_pose(synthetic_setup.TRUE_POSES["lidar"]) @ result.state.T_robot_sensor["lidar"]
    )
    at = slice(6 * sorted(made.models).index("lidar"), None)
    sigma = np.sqrt(np.diag(result.solved.covariance))[at][:6]
    return np.abs(off / sigma).max()


def test_dark_squares_that_read_12_mm_short_are_estimated_and_the_pose_is_right():
    made, result, suspected = refine(setup_of(SyntheticWorld(black_range_m=SHORT_M), "black"))
    found = find_correction_estimate(made, result, "dark_ranges", "lidar")
    assert found is not None and [c.name for c in made.corrections] == ["dark_ranges"]
    assert abs(found.values[0] - SHORT_M) < 3 * found.sigma[0] < 0.003
    assert lidar_error_in_sigma(made, result) < 3
    assert suspected == []


def test_where_white_comes_first_the_number_is_that_of_the_other_squares():
    """The squares that read 12 mm short are then the light ones: dark ones read 12 mm longer."""
    made, result, _ = refine(setup_of(SyntheticWorld(black_range_m=SHORT_M), "white"))
    found = find_correction_estimate(made, result, "dark_ranges", "lidar")
    assert found is None or found.values[0] > 0


def test_without_the_colour_of_the_first_square_each_colour_has_a_number():
    made, result, _ = refine(setup_of(SyntheticWorld(black_range_m=0.02)))
    found = find_correction_estimate(made, result, "dark_ranges", "lidar")
    assert found is not None
    assert np.all(np.abs(found.values - [0.02, 0.0]) < 3.5 * found.sigma)
    words = found.correction.describe(found.values, found.sigma)
    assert "longer on the squares of the colour of its first square" in words
    assert lidar_error_in_sigma(made, result) < 3


def test_where_it_must_not_be_estimated_it_is_named_with_what_to_write():
    made, _, suspected = refine(
        setup_of(SyntheticWorld(black_range_m=0.015), "black"), wanted=False
    )
    assert made.corrections == ()
    first = suspected[0]
    assert (first["name"], first["subject"]) == ("dark_ranges", "lidar")
    assert "longer on the dark squares of board than on the light ones" in first["description"]
    assert "pattern_returns: leave_out for board" in first["remedy"]


@pytest.mark.parametrize("seed", range(3))
def test_of_squares_that_read_alike_no_number_is_estimated(seed):
    made, _, suspected = refine(setup_of(SyntheticWorld(), "black", seed=seed))
    assert made.corrections == () and suspected == []


def test_with_its_returns_left_out_the_pattern_does_not_matter():
    """The pose of a board whose black squares read 15 mm long is that of one whose do not."""
    poses = []
    for black_range_m in (0.0, 0.015):
        made = setup_of(SyntheticWorld(black_range_m=black_range_m), "black", leaves_out=True)
        made, result, suspected = refine(made)
        assert made.corrections == () and suspected == []
        poses.append(result.state.T_robot_sensor["lidar"])
    off = np.abs(se3_log(invert_pose(poses[0]) @ poses[1]))
    assert off.max() < 1e-5
