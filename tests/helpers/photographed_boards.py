"""Boards photographed by a pinhole camera, and what the config states of them."""

import cv2
import numpy as np

from calib.extraction.mistakes.sightings import CameraSightings
from calib.extraction.mistakes.stated_setup import StatedSetup
from calib.geometry.se3 import invert_pose, make_pose, pose_from_rpy, so3_exp, transform_points
from calib.io.config import validate_and_complete
from calib.sensors.camera.camera_model import CameraModel
from calib.targets.board import Board
from calib.targets.patterns.checkerboard import Checkerboard
from calib.views.initial_guess_frames import FrameSample

GUESS_OPTIONS = validate_and_complete(
    "config", {"sessions": {"a": {"rig": "a", "log": "a"}}}, "config"
)["guess"]
LENS = CameraModel("radtan", (420.0, 420.0, 315.0, 245.0, 0.0, 0.0, 0.0, 0.0), (640, 480))
PATTERN = Checkerboard(7, 4, 0.06, (-0.14, -0.11), "black")
OUTLINE_M = 0.4 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
T_ROBOT_CAMERA = pose_from_rpy([0.31, -0.22, 0.54], np.radians([-101.0, 14.0, -68.0]))
T_BODY_BOARD = pose_from_rpy([0.12, 0.05, -0.08], np.radians([12.0, -21.0, 37.0]))
GUESS_SIGMA = np.repeat([0.03, np.radians(4)], 3)
PIXELS_PER_SQUARE = 24


def target_poses(n, seed=0):
    """T_camera_target (n, 4, 4) of boards in view, tilted and rolled by up to 35 deg."""
    rng, out = np.random.default_rng(seed), []
    for _ in range(n):
        turn = so3_exp([np.pi, 0, 0]) @ so3_exp(rng.uniform(-0.6, 0.6, 3))
        out.append(make_pose(turn, [*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.9, 1.4)]))
    return np.stack(out)


def draw_pattern(pattern):
    """Grey picture of the squares with a light border of one square, and its low corner, m."""
    columns, rows = pattern.n_columns + 1, pattern.n_rows + 1
    dark_first = pattern.first_square_color != "white"
    cells = (np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0) == dark_first
    squares = np.where(np.pad(cells, 1), 30, 220).astype(np.uint8)
    picture = np.kron(squares, np.ones((PIXELS_PER_SQUARE,) * 2, np.uint8))
    return picture, np.array(pattern.first_corner) - 2 * pattern.square_m


def photograph(pattern, T_camera_target, lens=LENS):
    """Image (h, w) of a pattern without distortion."""
    picture, low = draw_pattern(pattern)
    height, width = picture.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    xy = low + corners * pattern.square_m / PIXELS_PER_SQUARE
    uv, _ = lens.project(transform_points(T_camera_target, np.column_stack([xy, np.zeros(4)])))
    H = cv2.getPerspectiveTransform(corners - 0.5, uv.astype(np.float32))
    image = cv2.warpPerspective(picture, H, lens.size_px, flags=cv2.INTER_AREA, borderValue=120)
    return cv2.GaussianBlur(image, (0, 0), 0.7)


def make_board(pattern):
    """A board of OUTLINE_M with a pattern."""
    return Board(OUTLINE_M, 0.0, pattern)


def true_setup(pattern=PATTERN, n=8, lens=LENS, seed=0):
    """The StatedSetup of a right config, and its samples."""
    poses = target_poses(n, seed)
    T_robot_body = T_ROBOT_CAMERA @ poses @ invert_pose(T_BODY_BOARD)
    setup = StatedSetup(
        sensor="left",
        model=lens,
        targets={"plate": make_board(pattern)},
        mounts={"plate": T_BODY_BOARD},
        T_robot_body=dict(enumerate(T_robot_body)),
        T_robot_sensor=T_ROBOT_CAMERA,
        sigma=GUESS_SIGMA,
        images=tuple(photograph(pattern, T, lens) for T in poses),
    )
    samples = [FrameSample(k, "plate", k, T) for k, T in enumerate(T_robot_body)]
    return setup, CameraSightings(samples, GUESS_OPTIONS)
