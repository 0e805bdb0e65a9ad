"""A ChArUco board with other squares, another dictionary or layout than the config states."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.extraction.mistakes.mistake_search import find_mistake, find_other_pattern
from calib.extraction.mistakes.sightings import CameraSightings
from calib.extraction.mistakes.stated_setup import StatedSetup
from calib.geometry.se3 import invert_pose, transform_points
from calib.targets.patterns.charuco import Charuco
from calib.views.initial_guess_frames import FrameSample
from helpers.photographed_boards import (
    GUESS_OPTIONS,
    GUESS_SIGMA,
    LENS,
    T_BODY_BOARD,
    T_ROBOT_CAMERA,
    make_board,
    target_poses,
)

PATTERN = Charuco((7, 5), 0.06, 0.045, "DICT_4X4_50")
PIXELS_PER_SQUARE = 48


def photograph(T_camera_target):
    """Image (h, w) of the board, its middle at the origin, +y up."""
    columns, rows = PATTERN.n_squares
    size = np.array([columns, rows]) * PIXELS_PER_SQUARE
    picture = PATTERN._detector.getBoard().generateImage(size.tolist(), marginSize=0)
    half = PATTERN.square_m * np.array(PATTERN.n_squares) / 2
    xy = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * half  # the picture's rows run down
    uv, _ = LENS.project(transform_points(T_camera_target, np.column_stack([xy, np.zeros(4)])))
    ends = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size - 0.5
    H = cv2.getPerspectiveTransform(ends.astype(np.float32), uv.astype(np.float32))
    image = cv2.warpPerspective(picture, H, LENS.size_px, flags=cv2.INTER_AREA, borderValue=220)
    return cv2.GaussianBlur(image, (0, 0), 0.6)


@pytest.fixture(scope="module")
def seen():
    """A right config of a camera that sees a ChArUco board at five places."""
    poses = target_poses(5)
    T_robot_body = T_ROBOT_CAMERA @ poses @ invert_pose(T_BODY_BOARD)
    stated = StatedSetup(
        sensor="rear",
        model=LENS,
        targets={"plate": make_board(PATTERN)},
        mounts={"plate": T_BODY_BOARD},
        T_robot_body=dict(enumerate(T_robot_body)),
        T_robot_sensor=T_ROBOT_CAMERA,
        sigma=GUESS_SIGMA,
        images=tuple(photograph(T) for T in poses),
    )
    samples = [FrameSample(k, "plate", k, T) for k, T in enumerate(T_robot_body)]
    return stated, CameraSightings(samples, GUESS_OPTIONS)


def test_a_right_charuco_board_has_no_mistake(seen):
    assert find_mistake(*seen, 3) is None


@pytest.mark.parametrize(
    ("change", "remedy"),
    [
        ({"n_squares": (5, 7)}, "Set pattern.squares of plate to [7, 5]."),
        ({"n_squares": (8, 6)}, "Set pattern.squares of plate to [7, 5]."),
        ({"n_squares": (14, 11)}, "Set pattern.squares of plate to [7, 5]."),
        ({"dictionary": "DICT_APRILTAG_36H11"}, "pattern.dictionary of plate to DICT_4X4_1000."),
        ({"dictionary": "DICT_5X5_100"}, "Set pattern.dictionary of plate to DICT_4X4_1000."),
        ({"dictionary": "DICT_6X6_250", "n_squares": (7, 6)}, "to DICT_4X4_1000."),
    ],
)
def test_other_squares_or_markers_are_named_with_what_to_write(seen, change, remedy):
    stated, sightings = seen
    wrong = replace(stated, targets={"plate": make_board(replace(PATTERN, **change))})
    status = find_mistake(wrong, sightings, 3)
    assert status.reason.startswith("the images of rear show the ChArUco board of plate with ")
    assert status.remedy.endswith(remedy)


def test_a_charuco_board_in_mirrored_images_is_told_from_other_markers(seen):
    stated, sightings = seen
    flipped = tuple(np.ascontiguousarray(image[:, ::-1]) for image in stated.images)
    status = find_mistake(replace(stated, images=flipped), sightings, 3)
    assert status.reason == "the images of rear are mirrored left to right"


def test_markers_that_no_board_explains_are_counted_beside_those_expected(seen):
    """Half of the board is covered, so that no number of squares shows all of its corners."""
    stated, sightings = seen
    covered = tuple(image.copy() for image in stated.images)
    for image in covered:
        image[: image.shape[0] // 2] = 128
    wrong = {"plate": make_board(replace(PATTERN, n_squares=(4, 3)))}
    status = find_mistake(replace(stated, images=covered, targets=wrong), sightings, 3)
    assert status.reason.startswith("the images of rear show markers that the ChArUco board")
    assert re.fullmatch(r"\d+ markers of DICT_4X4_50, with ids up to 16", status.found)
    assert status.expected == "markers of DICT_4X4_50 with ids 0 to 5, of squares [4, 3]"
    assert "A board with 17 markers has 34 or 35 squares" in status.remedy


def test_a_board_of_unknown_mount_is_compared_with_the_images_alone(seen):
    stated, _ = seen
    assert find_other_pattern(stated) is None
    wrong = {"plate": make_board(replace(PATTERN, n_squares=(9, 12)))}
    status = find_other_pattern(replace(stated, targets=wrong))
    assert "with squares [7, 5], the config states squares [9, 12]" in status.reason
    assert status.remedy == "Set pattern.squares of plate to [7, 5]."
