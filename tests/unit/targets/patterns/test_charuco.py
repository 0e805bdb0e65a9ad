"""ChArUco boards: corners by their ids, whole or in part, as a camera sees them."""

from functools import cache

import cv2
import numpy as np
import pytest

from calib.geometry.se3 import invert_pose, make_pose, so3_exp, transform_points
from calib.io.config import validate_and_complete
from calib.io.status import InputError
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.camera.images.image_messages import to_grey
from calib.targets.patterns.charuco import Charuco
from calib.targets.target_shapes import target_from_config

PATTERN = Charuco((5, 7), 0.06, 0.045, "DICT_6X6_250")
CAMERA = CameraModel(
    "radtan", (900.0, 900.0, 449.5, 349.5, -0.1, 0.02, 0.0005, -0.0003), (900, 700)
)
POSE = make_pose(so3_exp([0.3, -0.2, 0.1]) @ np.diag([1.0, -1, -1]), [0.02, -0.01, 0.8])
COVERED = 400  # columns
BLOCK = {
    "body": "b",
    "shape": "board",
    "pattern": {
        "kind": "charuco",
        "squares": [5, 7],
        "square_m": 0.06,
        "marker_m": 0.045,
        "dictionary": "DICT_6X6_250",
    },
}


@cache
def photographed():
    """A grey image (h, w) uint8 of the board at POSE before a grey wall, blur 0.7 px, noise 1.8; 4
    rays a pixel each way."""
    px = 40  # of the print, per square
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    board = cv2.aruco.CharucoBoard(
        PATTERN.n_squares, PATTERN.square_m, PATTERN.marker_m, dictionary
    )
    printed = board.generateImage((5 * px, 7 * px), marginSize=0)
    width, height = CAMERA.size_px
    half_m = np.array([2.5, 3.5]) * PATTERN.square_m
    corners = [[x * half_m[0], y * half_m[1], 0] for x in (-1, 1) for y in (-1, 1)]
    on_image, _ = CAMERA.project(transform_points(POSE, np.array(corners)))
    (left, top), (right, bottom) = np.floor(on_image.min(0) - 1), np.ceil(on_image.max(0) + 2)
    columns, rows = np.arange(left, right, 0.25) - 0.375, np.arange(top, bottom, 0.25) - 0.375
    uv = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    T = invert_pose(POSE)
    rays, _ = CAMERA.unproject(uv)
    rays = rays @ T[:3, :3].T
    hit = T[:3, 3] - rays * (T[2, 3] / rays[:, 2])[:, None]
    column = np.floor((hit[:, 0] / PATTERN.square_m + 2.5) * px).astype(int)
    row = np.floor((3.5 - hit[:, 1] / PATTERN.square_m) * px).astype(int)
    inside = (column >= 0) & (column < 5 * px) & (row >= 0) & (row < 7 * px)
    grey = np.full(len(uv), 120.0)
    grey[inside] = 40 + 160 / 255 * printed[row[inside], column[inside]]
    image = np.full((height, width), 120.0)
    pixels = grey.reshape(len(rows) // 4, 4, len(columns) // 4, 4).mean((1, 3))
    image[int(top) : int(bottom), int(left) : int(right)] = pixels
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    image += 1.8 * np.random.default_rng(0).normal(size=image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def test_every_corner_is_found_by_its_own_number_to_a_thirtieth_of_a_pixel():
    """Quadrature of 4 × 4 rays and the cells of the print make up most of the error."""
    found, status = PATTERN.locate_corners(photographed(), CAMERA, np.zeros(2))
    assert status.ok and sorted(found.corner_index) == list(range(24))
    true, _ = CAMERA.project(transform_points(POSE, PATTERN.corners()))
    off = found.uv - true[found.corner_index]
    assert np.sqrt(np.mean(off**2)) < 0.035


def test_a_part_of_the_board_tells_which_part_it_is():
    image = photographed().copy()
    image[:, :COVERED] = 120
    found, status = PATTERN.locate_corners(image, CAMERA, np.zeros(2))
    assert 6 <= len(found.corner_index) < 24 and "corners not seen" in status.reason
    true, _ = CAMERA.project(transform_points(POSE, PATTERN.corners()))
    assert np.abs(found.uv - true[found.corner_index]).max() < 0.2


def test_a_region_of_the_image_gives_pixels_of_the_whole():
    image, offset = photographed(), np.array([180, 90])
    whole, _ = PATTERN.locate_corners(image, CAMERA, np.zeros(2))
    part, _ = PATTERN.locate_corners(image[90:, 180:], CAMERA, offset)
    both = np.isin(whole.corner_index, part.corner_index)
    np.testing.assert_allclose(
        part.uv[np.argsort(part.corner_index)],
        whole.uv[both][np.argsort(whole.corner_index[both])],
        atol=0.01,
    )


def test_an_image_without_the_board_says_what_was_expected():
    found, status = PATTERN.locate_corners(np.full((200, 300), 120, np.uint8), CAMERA, np.zeros(2))
    assert found is None and not status.ok
    assert "0 corners" in status.found and "6 or more of 24 inner corners" in status.expected


def test_a_board_that_was_printed_mirrored_is_told_from_none():
    mirrored = np.ascontiguousarray(photographed()[:, ::-1])
    found, status = PATTERN.locate_corners(mirrored, CAMERA, np.zeros(2))
    assert found is None and status.reason == "the ChArUco board is seen mirrored"
    assert status.remedy.startswith("Print it again without mirroring")


def test_rows_run_upwards_and_columns_to_the_right_about_the_middle():
    corners = PATTERN.corners().reshape(6, 4, 3)
    np.testing.assert_allclose(corners[0, 0], [-0.09, -0.15, 0])
    np.testing.assert_allclose(corners[0, 1] - corners[0, 0], [0.06, 0, 0])
    np.testing.assert_allclose(corners[1, 0] - corners[0, 0], [0, 0.06, 0], atol=1e-12)
    np.testing.assert_allclose(corners.mean((0, 1)), 0, atol=1e-12)


def test_its_outline_is_that_of_the_print_unless_stated_and_gives_no_lidar_an_edge():
    block = validate_and_complete("target", BLOCK, "x")
    board = target_from_config(block)
    np.testing.assert_allclose(np.abs(board.vertices), [[0.15, 0.21]] * 4)
    assert len(board.outline_edges()) == 0
    stated = BLOCK | {"outline_m": [[0.2, 0.3], [-0.2, 0.3], [-0.2, -0.3], [0.2, -0.3]]}
    assert (
        len(target_from_config(validate_and_complete("target", stated, "x")).outline_edges()) == 4
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dictionary": "6x6"}, "is not a valid name"),
        ({"squares": [5]}, "squares"),
        ({"kind": "qr"}, "kind"),
    ],
)
def test_a_wrong_pattern_is_refused_with_its_key(change, message):
    with pytest.raises(InputError, match=message):
        validate_and_complete("target", BLOCK | {"pattern": BLOCK["pattern"] | change}, "x")


def test_a_checkerboard_still_needs_an_outline():
    pattern = {"kind": "checkerboard", "inner_corners": [6, 5], "square_m": 0.1}
    block = {"body": "b", "shape": "board", "pattern": pattern | {"first_corner_m": [0, 0]}}
    with pytest.raises(InputError, match="missing key outline_m"):
        validate_and_complete("target", block, "x")


def test_colour_images_are_read_alike():
    grey = photographed()
    again = to_grey(np.repeat(grey[..., None], 3, -1))
    np.testing.assert_array_equal(again, grey)
