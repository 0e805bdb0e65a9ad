"""How dark a pattern is where a beam hits it, and which returns are left out with it."""

import cv2
import numpy as np
import pytest

from calib.io.config import validate_and_complete
from calib.io.status import InputError
from calib.targets.board import Board
from calib.targets.patterns.charuco import Charuco
from calib.targets.patterns.checkerboard import Checkerboard

OUTLINE_M = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
SQUARE_M = 0.1
# Squares from (-0.3, -0.2) to (0.3, 0.2): 6 by 4.
FIRST = np.array([-0.25, -0.15])  # middle of the first square


def checkerboard(first_square):
    return Checkerboard(5, 3, SQUARE_M, (-0.2, -0.1), first_square)


@pytest.mark.parametrize(("first_square", "dark"), [("black", 1.0), ("white", 0.0)])
def test_the_first_square_of_a_checkerboard_has_the_stated_colour(first_square, dark):
    pattern = checkerboard(first_square)
    xy = np.array([FIRST, FIRST + [SQUARE_M, 0], FIRST + [SQUARE_M, SQUARE_M], [0.4, 0.0]])
    np.testing.assert_array_equal(pattern.darkness(xy)[:, 0], [dark, 1 - dark, dark, 0.0])


def test_without_a_stated_colour_each_colour_has_a_column():
    xy = np.array([FIRST, FIRST + [SQUARE_M, 0], [0.4, 0.0]])
    np.testing.assert_array_equal(checkerboard(None).darkness(xy), [[1, 0], [0, 1], [0, 0]])


@pytest.mark.parametrize("is_legacy", [False, True])
def test_a_charuco_board_is_dark_where_opencv_prints_it_so(is_legacy):
    """Against the picture of the whole board, 256 px a square, rows down, at 300 random points."""
    pattern = Charuco((5, 4), SQUARE_M, 0.07, "DICT_5X5_100", is_legacy)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    board = cv2.aruco.CharucoBoard((5, 4), SQUARE_M, 0.07, dictionary)
    board.setLegacyPattern(is_legacy)
    printed = board.generateImage((1280, 1024))
    rng = np.random.default_rng(0)
    xy = rng.uniform([-0.25, -0.2], [0.25, 0.2], (300, 2))
    column, row = ((xy * [1, -1] + [0.25, 0.2]) * 2560).astype(int).T
    agrees = (pattern.darkness(xy)[:, 0] > 0.5) == (printed[row, column] < 128)
    assert agrees.mean() > 0.95  # but within half a pixel, 0.8 mm, of an edge
    assert pattern.darkness(np.array([[0.26, 0.0]])).item() == 0.0


def test_a_spot_on_the_edge_of_two_squares_is_half_dark():
    board = Board(OUTLINE_M, 0.0, checkerboard("black"))
    edge = np.array([[-0.2, -0.15, 0.0], [*FIRST, 0.0]])
    dark = board.pattern_darkness(edge, np.full(2, 0.02))[:, 0]
    np.testing.assert_allclose(dark, [0.5, 1.0], atol=0.08)


def test_returns_are_left_out_as_far_as_their_spots_reach_into_the_pattern():
    board = Board(OUTLINE_M, 0.0, checkerboard("black"), leaves_out_pattern=True)
    points = np.array([[0.0, 0.0, 0.0], [0.305, 0.0, 0.0], [0.32, 0.0, 0.0]])
    np.testing.assert_array_equal(board.is_left_out(points, np.full(3, 0.01)), [True, True, False])
    kept = Board(OUTLINE_M, 0.0, checkerboard("black"))
    assert not kept.is_left_out(points, np.full(3, 0.01)).any()


def test_leaving_out_the_pattern_of_a_board_without_a_rim_is_refused():
    pattern = {"kind": "checkerboard", "inner_corners": [5, 3], "square_m": SQUARE_M}
    board = {"body": "b", "shape": "board", "pattern_returns": "leave_out"}
    board["pattern"] = pattern | {"first_corner_m": [-0.2, -0.1]}
    with pytest.raises(InputError, match="outline_m"):
        validate_and_complete("target", board, "config/targets/board.yaml")
    completed = validate_and_complete(
        "target", board | {"outline_m": OUTLINE_M.tolist()}, "config/targets/board.yaml"
    )
    assert Board.from_config(completed).leaves_out_pattern
