"""Corners of rendered boards against their exact pixels: error, its covariance, and what is in the
way. All images carry noise of 1.8 grey levels, as the benchmark's."""

import time

import cv2
import numpy as np
import pytest

from calib.estimation.residuals.assignment import Noise
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.geometry.se3 import make_pose, so3_exp, transform_points
from calib.sensors.camera.camera_model import CameraModel
from calib.targets.patterns.edge_model import fit_corner_edges
from calib.targets.patterns.grid_growing import find_alternating_crossings, grow_and_trim_grid
from calib.targets.patterns.image_region import GridPlane, ImageRegion, make_grid_cells
from calib.targets.patterns.opencv_grids import find_grid_fast
from calib.targets.target_shapes import target_from_config
from simulation.sensors.camera_exposure import BGR_TO_GREY, blur_image
from simulation.sensors.image_renderer import compute_ray_grid, render_image
from simulation.world.ray_casting import PosedScene
from simulation.world.room_scene import SIMULATED_TARGETS, build_scene, place_surfaces

NOISE = 1.8
BOARD = target_from_config(SIMULATED_TARGETS["board"] | {"thickness_m": 0.005})
PATTERN = BOARD.pattern
SIZE = (330, 300)
# The image's middle is 18° off the lens's axis where that distorts.
CAMERAS = {
    "pinhole": CameraModel("radtan", (802.3, 801.1, 166.2, 148.7, 0, 0, 0, 0), SIZE),
    "radtan": CameraModel("radtan", (802.3, 801.1, -83.4, 28.7, -0.28, 0.09, 6e-4, -4e-4), SIZE),
    "fisheye": CameraModel(
        "kannala_brandt", (420, 419, 30.2, 100.7, -0.013, 0.021, -0.014, 0.003), SIZE
    ),
}
DISTANCES = {"pinhole": 2.1, "radtan": 2.1, "fisheye": 2.4}
LEANS_DEG = ([24, -18, 12], [-20, 25, 100], [5, 30, -140])
EYE = make_pose(np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]]), [-1.5, 0, 1.5])


def posed(camera, distance, lean_deg):
    """T_camera_target of a board in the middle of the image that leans from facing the camera."""
    middle = camera.unproject(np.array(SIZE)[None] / 2)[0][0]
    facing = np.stack([[1.0, 0, 0], np.cross(-middle, [1.0, 0, 0]), -middle], -1)
    R = np.linalg.qr(facing)[0]
    R = R * np.sign(np.sum(R * facing, axis=0))
    return make_pose(R @ so3_exp(np.radians(lean_deg)), distance * middle)


def exact(name, distance, lean_deg):
    """(grey image (h, w) without noise, pixels (n, 2) of the corners)."""
    camera = CAMERAS[name]
    T = posed(camera, distance, lean_deg)
    surfaces = place_surfaces({"board": EYE @ T})
    image = render_image(VIEWS[name], PosedScene(build_scene(["board"]), surfaces, EYE))
    uv, valid = camera.project(transform_points(T, PATTERN.corners()))
    assert valid.all() and camera.is_in_image(uv, 15).all()
    return image @ BGR_TO_GREY, uv


VIEWS = {name: compute_ray_grid(camera) for name, camera in CAMERAS.items()}


@pytest.fixture(scope="module")
def boards():
    return {n: [exact(n, DISTANCES[n], lean) for lean in LEANS_DEG] for n in CAMERAS}


@pytest.fixture(scope="module")
def board(boards):
    """The first pinhole view, a little blurred."""
    image, uv = boards["pinhole"][0]
    return blur_image(image, 0.7), uv


def taken(image, rng, noise=NOISE):
    """The image (h, w) uint8 with noise."""
    noisy = image + noise * rng.standard_normal(image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def numbered(uv, truth):
    """The truth (n, 2) in the order of all corners uv (m, 2), by the nearest; and their errors."""
    nearest = np.linalg.norm(uv[:, None] - truth, axis=-1).argmin(1)
    assert len(set(nearest)) == len(uv)
    return uv - truth[nearest], nearest


def located(image, name="pinhole"):
    corners, status = PATTERN.locate_corners(image, CAMERAS[name], np.zeros(2))
    assert status.ok, str(status)
    return corners, status


# --- error and covariance


@pytest.fixture(scope="module")
def measured(boards):
    """case -> (errors (n, 2), their size in σ squared (n,)), of 3 draws of noise in 3 views."""
    out = {}
    for name, blur in CASES:
        rng, errors, sizes = np.random.default_rng(3), [], []
        for image, truth in boards[name] * 3:
            corners, status = located(taken(blur_image(image, blur), rng), name)
            assert status.reason == "" and len(corners.uv) == len(truth)
            error, _ = numbered(corners.uv, truth)
            errors.append(error)
            a, b, c = corners.whitening.T
            white = np.stack([a * error[:, 0] + b * error[:, 1], c * error[:, 1]], -1)
            sizes.append((white**2).sum(1) / corners.sigma**2)
        out[name, blur] = np.concatenate(errors), np.concatenate(sizes)
    return out


CASES = {
    ("pinhole", 0.0): 0.005,
    ("pinhole", 0.7): 0.008,
    ("pinhole", 1.0): 0.008,
    ("radtan", 0.7): 0.008,
    ("fisheye", 0.7): 0.015,
}
every_case = pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c[0]} blur {c[1]} px")


@every_case
def test_the_error_per_axis_is_within_the_goal(measured, case):
    assert np.sqrt((measured[case][0] ** 2).mean()) < CASES[case]


@every_case
def test_the_error_has_no_mean(measured, case):
    """A hundred corners or more of each view share what bias there is: a sixth of the goal."""
    assert np.abs(measured[case][0].mean(0)).max() < CASES[case] / 6


@every_case
def test_the_error_is_as_large_as_its_covariance_says(measured, case):
    """270 corners: the mean of χ²/2 of two degrees of freedom is 1 ± 0.06."""
    assert 0.8 < measured[case][1].mean() / 2 < 1.25
    assert measured[case][1].max() < 30


def test_a_corner_takes_at_most_3_ms(boards):
    image, truth = boards["pinhole"][1]
    region = ImageRegion(taken(image, np.random.default_rng(0)), CAMERAS["pinhole"], np.zeros(2))
    cells = make_grid_cells(6, 5).reshape(-1, 2)
    sides = grid_of(region, truth).cell_sides(cells)
    started = time.process_time()
    for _ in range(5):
        fit = fit_corner_edges(region, truth + 0.3, *sides)
    assert fit.is_valid.all()
    assert (time.process_time() - started) / 5 / len(truth) < 3e-3


def grid_of(region, uv):
    return GridPlane.fit_cells(region, make_grid_cells(6, 5).reshape(-1, 2), uv)


def test_corners_are_found_alike_from_seeds_a_pixel_off(board):
    image, truth = board
    region = ImageRegion(taken(image, np.random.default_rng(0)), CAMERAS["pinhole"], np.zeros(2))
    sides = grid_of(region, truth).cell_sides(make_grid_cells(6, 5).reshape(-1, 2))
    rng = np.random.default_rng(1)
    fits = [fit_corner_edges(region, truth + rng.uniform(-1, 1, truth.shape), *sides) for _ in "ab"]
    assert all(f.is_valid.all() for f in fits)
    assert np.abs(fits[0].uv - fits[1].uv).max() < 0.01


def test_the_region_of_an_image_gives_the_pixels_of_the_image(board):
    image, _ = board
    grey = taken(image, np.random.default_rng(0))
    whole, _ = located(grey)
    cut = np.ascontiguousarray(grey[11:, 17:])
    part, _ = PATTERN.locate_corners(cut, CAMERAS["pinhole"], np.array([17, 11]))
    assert np.linalg.norm(whole.uv - part.uv, axis=1).max() < 2e-3


def test_a_covariance_and_its_whitening_agree(board):
    corners, _ = located(taken(board[0], np.random.default_rng(0)))
    a, b, c = corners.whitening.T
    W = np.stack([np.stack([a, b], -1), np.stack([0 * a, c], -1)], 1)
    white = W @ corners.covariance @ np.swapaxes(W, 1, 2)
    expected = corners.sigma[:, None, None] ** 2 * np.eye(2)
    assert white == pytest.approx(np.broadcast_to(expected, white.shape), abs=1e-12)


# --- corners that are covered


def pole(image, u, width):
    """The image with a grey upright pole over the columns u ± width / 2."""
    out = image.copy()
    out[:, round(u - width / 2) : round(u + width / 2)] = 90
    return out


@pytest.mark.parametrize("width", [3, 7, 13])
def test_corners_behind_a_pole_are_left_out_and_the_others_unharmed(board, width):
    image, truth = board
    u = truth[14, 0]
    corners, status = located(taken(pole(image, u, width), np.random.default_rng(2)))
    error, which = numbered(corners.uv, truth)
    covered = np.abs(truth[:, 0] - u) < width / 2 + 1
    clear = np.abs(truth[:, 0] - u) > width / 2 + 20
    assert not covered[which].any() and set(np.flatnonzero(clear)) <= set(which)
    assert np.abs(error).max() < 0.03
    assert status.reason == f"{30 - len(which)} of 30 corners are covered"


def test_a_pole_across_the_whole_grid_leaves_both_its_parts(board):
    """21 px of a grid of 26 px squares: the quick detector and the thorough one see parts only."""
    image, truth = board
    u = truth[14, 0]
    grey = taken(pole(image, u, 21), np.random.default_rng(2))
    assert find_grid_fast(grey, 6, 5) is None
    corners, _ = located(grey)
    error, which = numbered(corners.uv, truth)
    assert np.abs(error).max() < 0.03
    assert (truth[which, 0] < u).any() and (truth[which, 0] > u).any()


def test_places_in_a_partial_grid_are_those_in_the_whole_one(board):
    image, truth = board
    whole, _ = located(taken(image, np.random.default_rng(2)))
    part, _ = located(taken(pole(image, truth[14, 0], 7), np.random.default_rng(2)))
    same = whole.uv[part.corner_index] - part.uv
    turned = whole.uv[29 - part.corner_index] - part.uv
    assert min(np.abs(same).max(), np.abs(turned).max()) < 0.03


def test_a_board_that_is_mostly_covered_is_refused_in_words(board):
    image, truth = board
    grey = taken(pole(image, truth[:, 0].mean(), 110), np.random.default_rng(2))
    corners, status = PATTERN.locate_corners(grey, CAMERAS["pinhole"], np.zeros(2))
    assert corners is None and not status.ok
    assert status.expected == "6 × 5 inner corners" and status.found


def test_the_labelling_of_a_partial_grid_finds_every_corner(board):
    image, truth = board
    corners, _ = located(taken(pole(image, truth[14, 0], 7), np.random.default_rng(2)))
    n = len(corners.uv)
    keypoints = {"view": np.zeros(n, int), "feature_index": corners.corner_index, "uv": corners.uv}
    keypoints |= {"sigma": corners.sigma, "whitening": corners.whitening}
    T = posed(CAMERAS["pinhole"], 2.1, LEANS_DEG[0])
    options, noise = {"gate_sigma": 6.0}, Noise(1.0, 0.0)
    found = RESIDUAL_KINDS["pattern_corner"].assign(
        CAMERAS["pinhole"], BOARD, T, keypoints, options=options, noise=noise
    )
    _, which = numbered(corners.uv, truth)
    assert np.array_equal(found.feature, which)
    assert found.standardized.std() == pytest.approx(1, rel=0.3)


# --- grids that are not what they seem


def seeds(truth):
    return truth.reshape(5, 6, 2)


@pytest.mark.parametrize("columns, rows", [(1, 0), (-1, 0), (0, 1), (0, -1), (1, -1)])
def test_a_grid_shifted_by_a_square_is_put_right(board, columns, rows):
    image, truth = board
    region = ImageRegion(taken(image, np.random.default_rng(0)), CAMERAS["pinhole"], np.zeros(2))
    shifted = grid_of(region, truth).project_cells(make_grid_cells(6, 5) + [columns, rows])
    uv, _ = grow_and_trim_grid(region, shifted, fit_corner_edges)
    assert uv.shape == (5, 6, 2)
    assert np.abs(uv - seeds(truth)).max() < 0.1


def test_a_part_of_a_grid_grows_to_all_of_it(board):
    image, truth = board
    region = ImageRegion(taken(image, np.random.default_rng(0)), CAMERAS["pinhole"], np.zeros(2))
    uv, _ = grow_and_trim_grid(region, seeds(truth)[1:4, 2:5], fit_corner_edges)
    assert np.abs(uv - seeds(truth)).max() < 0.1


def test_the_border_of_the_pattern_is_no_further_row_of_crossings(board):
    image, truth = board
    region = ImageRegion(taken(image, np.random.default_rng(0)), CAMERAS["pinhole"], np.zeros(2))
    crossing, sign = find_alternating_crossings(grid_of(region, truth), make_grid_cells(6, 5, 2))
    assert crossing[2:-2, 2:-2].all() and crossing.sum() == 30
    assert sign == -1  # ahead of the first corner lies the second square of a diagonal: black


def test_a_grid_between_the_corners_is_none(board):
    image, truth = board
    region = ImageRegion(taken(image, np.random.default_rng(0)), CAMERAS["pinhole"], np.zeros(2))
    between = grid_of(region, truth).project_cells(make_grid_cells(6, 5) + 0.5)
    assert grow_and_trim_grid(region, between, fit_corner_edges) is None


def test_seeds_on_no_plane_are_no_grid(board):
    image, truth = board
    region = ImageRegion(taken(image, np.random.default_rng(0)), CAMERAS["pinhole"], np.zeros(2))
    bent = seeds(truth) + np.random.default_rng(0).uniform(-15, 15, (5, 6, 2))
    assert grow_and_trim_grid(region, bent, fit_corner_edges) is None


def floor_of(tiles, size, turn_deg):
    """Grey image of SIZE of square tiles (n, n), 0 or 1, `size` px wide, turned."""
    flat = (40 + 160 * tiles.repeat(size, 0).repeat(size, 1)).astype(np.float32)
    turn = cv2.getRotationMatrix2D((len(flat) / 2, len(flat) / 2), turn_deg, 1)
    turn[:, 2] += np.array(SIZE) / 2 - len(flat) / 2
    return blur_image(cv2.warpAffine(flat, turn, SIZE, flags=cv2.INTER_CUBIC), 0.7)


@pytest.mark.parametrize("kind", ["by turns", "at random"])
def test_a_tiled_floor_is_no_board(kind):
    rng = np.random.default_rng(8)
    tiles = np.add.outer(np.arange(24), np.arange(24)) % 2
    tiles = tiles if kind == "by turns" else rng.integers(0, 2, tiles.shape)
    grey = taken(floor_of(tiles, 24, 17), rng)
    corners, status = PATTERN.locate_corners(grey, CAMERAS["pinhole"], np.zeros(2))
    assert corners is None and not status.ok


def test_where_no_edges_cross_no_corner_is_refined():
    flat = ImageRegion(np.full(SIZE[::-1], 99, np.uint8), CAMERAS["pinhole"], np.zeros(2))
    at = np.array([[100.2, 90.4], [5.0, 5.0], [np.nan, 7.0]])
    sides = np.tile([[20.0, 1]], (3, 1)), np.tile([[-1.0, 20]], (3, 1))
    assert not fit_corner_edges(flat, at, *sides).is_valid.any()


# --- boards that are hard to see


def without_border(image, truth):
    """The image, all beyond the squares of the pattern as dark as they are."""
    region = ImageRegion(image.astype(np.uint8), CAMERAS["pinhole"], np.zeros(2))
    ends = np.array([[-1, -1], [6, -1], [6, 5], [-1, 5]])
    inside = np.zeros(image.shape, np.uint8)
    cv2.fillPoly(inside, [np.rint(grid_of(region, truth).project_cells(ends)).astype(np.int32)], 1)
    return np.where(inside, image, 40.0)


def light_from_one_side(image, truth):
    """The image, the light on the board's left a fifth of that on its right."""
    u = np.arange(image.shape[1])
    low, high = truth[:, 0].min(), truth[:, 0].max()
    return image * np.clip(0.2 + 0.8 * (u - low) / (high - low), 0.15, 1.1)


@pytest.mark.parametrize("change, limit", [(without_border, 0.03), (light_from_one_side, 0.08)])
def test_a_board_without_border_or_in_uneven_light_is_found(board, change, limit):
    image, truth = board
    corners, _ = located(taken(change(image, truth), np.random.default_rng(4)))
    error, _ = numbered(corners.uv, truth)
    assert len(error) >= 25 and np.abs(error).max() < limit


def test_uneven_light_does_not_pull_the_corners(board):
    """The mean is what is left of the fall of light across a corner."""
    image, truth = board
    corners, _ = located(taken(light_from_one_side(image, truth), np.random.default_rng(4)))
    error, _ = numbered(corners.uv, truth)
    assert np.abs(error.mean(0)).max() < 0.005


@pytest.mark.parametrize("lean_deg", [[0, 75, 0], [75, 0, 0], [50, 50, 20]])
def test_a_steep_board_is_found(lean_deg):
    """Squares of 31 by 8 px, or rhombs as flat: what is looked at follows the grid."""
    image, truth = exact("pinhole", 2.1, lean_deg)
    corners, _ = located(taken(blur_image(image, 0.7), np.random.default_rng(5)))
    error, _ = numbered(corners.uv, truth)
    assert len(error) >= 28 and np.abs(error).max() < 0.05


# --- edges that are not as the model has them


def sharpened(image):
    """The image with each edge's halo as a camera makes it, more on its left than on its right."""
    soft = blur_image(image, 1.2)
    halo = image - np.roll(blur_image(image, 2.0), -1, axis=1)
    return soft + 0.9 * halo


def test_where_edges_are_unlike_the_model_corners_are_where_gradients_meet(board):
    """A few hundredths of a pixel, and one error for all of them."""
    image, truth = board
    corners, _ = located(taken(sharpened(image), np.random.default_rng(6)))
    error, _ = numbered(corners.uv, truth)
    assert np.abs(error - error.mean(0)).max() < 0.1
    assert np.ptp(corners.sigma) == 0
