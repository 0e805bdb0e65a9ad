"""Setups whose measurements are made by formula, of targets, lenses and mounts as they are built,
which need not be what the Setup says of them."""

from dataclasses import dataclass, field, replace

import numpy as np

from calib.estimation.estimation_problem import MeasurementGroup, Placement, Setup
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import (
    invert_pose,
    make_pose,
    pose_from_rpy,
    se3_exp,
    so3_exp,
    transform_points,
)
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.board import Board
from calib.targets.cylinder import Cylinder
from calib.targets.patterns.checkerboard import Checkerboard

LENS_PARAMS = (800.0, 800.0, 449.5, 349.5, -0.1, 0.02, 0.0005, -0.0003)
CAMERA_MODEL = CameraModel("radtan", LENS_PARAMS, (900, 700))
AZIMUTH_STEP_RAD = np.radians(0.2)
LIDAR_MODEL = LidarModel(AZIMUTH_STEP_RAD, np.radians(2.0), None, None, (0.3, 100.0), 0.01)
BOARD_OUTLINE_M = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
BOARD_TARGET = Board(BOARD_OUTLINE_M, 0.0, Checkerboard(6, 5, 0.08, (-0.2, -0.16)), flatness=0.002)
CYLINDER_TARGET = Cylinder(0.8, 0.1)
TARGETS_BY_NAME = {"board": BOARD_TARGET, "cylinder": CYLINDER_TARGET}
SENSOR_MODELS = {"camera": CAMERA_MODEL, "lidar": LIDAR_MODEL}
ASSOCIATE_SETTINGS = {"gate_sigma": 6.0, "edge_margin_m": 0.02, "min_cosine": 0.3}
R_ROBOT_FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # both look along the robot's x
TRUE_POSES = {
    "camera": make_pose(R_ROBOT_FORWARD, [0.2, 0.1, 0.5]),
    "lidar": pose_from_rpy([0.1, -0.05, 0.7], [0.02, -0.03, 0.05]),
}
MCS_SIGMA = np.repeat([1e-4, np.radians(0.01)], 3)
PIXEL_SIGMA_PX, RANGE_SIGMA_M = 0.05, 0.01  # px, m: noise, which is also what the Setup starts from
N_RINGS = 12


@dataclass(frozen=True)
class SyntheticWorld:
    """What is there: targets, lens, T_body_target by target (identity) and by how much, m, the
    lidar's ranges are too long, for every ring, to squares of a board that are black if its first
    one is, and at intensity 0 rather than 100; None: the lidar tells no intensity."""

    targets: dict = field(default_factory=lambda: TARGETS_BY_NAME)
    camera: CameraModel = CAMERA_MODEL
    T_body_target: dict = field(default_factory=dict)
    range_bias_m: np.ndarray = field(default_factory=lambda: np.zeros(N_RINGS))
    black_range_m: float = 0.0
    weak_range_m: float | None = None


def scale_pattern(factor):
    """Targets with a pattern of squares so much larger, about its middle."""
    p = BOARD_TARGET.pattern
    grown = Checkerboard(6, 5, factor * p.square_m, tuple(factor * np.array(p.first_corner)))
    return TARGETS_BY_NAME | {"board": replace(BOARD_TARGET, pattern=grown)}


def scale_outline(x, y):
    """Targets with an outline so much wider and higher."""
    return TARGETS_BY_NAME | {"board": replace(BOARD_TARGET, vertices=BOARD_OUTLINE_M * [x, y])}


def warp_board(bow_x, bow_y, twist):
    """Targets with a board that is bowed and twisted by so much, m."""
    return TARGETS_BY_NAME | {"board": replace(BOARD_TARGET, warp=(bow_x, bow_y, twist))}


def scale_focal_length(factor):
    """The camera with a focal length so much longer."""
    return replace(
        CAMERA_MODEL, params=(factor * LENS_PARAMS[0], factor * LENS_PARAMS[1], *LENS_PARAMS[2:])
    )


def make_synthetic_setup(
    seed, layout, world=None, mcs_noise_factor=1.0, measurement_noise_factor=1.0
):
    """A Setup of placements [(target, axis of a cylinder or None)]; mcs and
    measurement_noise_factor: times theirs.

    The camera sees boards, the lidar everything. Placements are the same for every seed.
    """
    world = world or SyntheticWorld()
    rng, where = np.random.default_rng(seed), np.random.default_rng(99)
    places, groups = [], []
    for k, (name, axis) in enumerate(layout):
        T_robot_target = _draw_target_pose(where, name, axis)
        errors = se3_exp(mcs_noise_factor * MCS_SIGMA * rng.normal(size=(2, 6)))
        T_target_body = invert_pose(world.T_body_target.get(name, np.eye(4)))
        said = errors[0] @ T_robot_target @ T_target_body @ invert_pose(errors[1])
        places.append(Placement("s", name, said, np.eye(4), MCS_SIGMA, start_ns=k))
        groups += _measure_groups(rng, world, k, name, T_robot_target, measurement_noise_factor)
    models = {n: m for n, m in SENSOR_MODELS.items() if any(g.sensor == n for g in groups)}
    return Setup(models, TARGETS_BY_NAME, places, groups, ASSOCIATE_SETTINGS, {})


def solve_synthetic_setup(setup, max_rounds=30):
    """The Result of so many rounds at most from a start that is off by about 5 mm and 0.3°."""
    start = {n: TRUE_POSES[n] @ se3_exp(np.full(6, 0.005)) for n in setup.models}
    return estimate_poses(
        setup,
        start,
        max_rounds=max_rounds,
        tolerance_m=1e-5,
        tolerance_rad=1e-5,
        initial_noise_factor=100.0,
    )


def _draw_target_pose(rng, name, axis):
    """A target 1.5 to 3 m before the robot, turned at random; a cylinder's axis may be given."""
    at = rng.uniform([1.5, -0.4, 0.3], [3.0, 0.4, 0.9])
    if name == "board":
        turn = so3_exp(rng.uniform(-0.6, 0.6, 3))
        return make_pose(turn @ np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]]), at)
    x = rng.normal(size=3) if axis is None else np.asarray(axis, float)
    x /= np.linalg.norm(x)
    y = np.cross(x, [0.3, 0.5, 0.8])
    y /= np.linalg.norm(y)
    return make_pose(np.column_stack([x, y, np.cross(x, y)]), at)


def _measure_groups(rng, world, placement_index, name, T_robot_target, measurement_noise_factor):
    found = measure_target(
        rng, world, "lidar", placement_index, name, T_robot_target, measurement_noise_factor
    )
    if name == "board":
        found += measure_target(
            rng, world, "camera", placement_index, name, T_robot_target, measurement_noise_factor
        )
    return found


def measure_target(
    rng, world, sensor, placement_index, target_name, T_robot_target, measurement_noise_factor=1.0
):
    """The Groups of what one of the sensors measures of a target."""
    target, T = world.targets[target_name], invert_pose(TRUE_POSES[sensor]) @ T_robot_target
    if sensor == "lidar":
        found = [
            MeasurementGroup(
                "lidar",
                placement_index,
                "target_surface",
                _draw_returns(rng, world, target, T, placement_index, measurement_noise_factor),
            )
        ]
        if target_name == "board":
            found.append(
                MeasurementGroup(
                    "lidar",
                    placement_index,
                    "board_outline",
                    _draw_crossings(rng, target, T, placement_index, measurement_noise_factor),
                )
            )
        return found
    corners = target.lift(target.pattern.corners())
    uv, valid = world.camera.project(transform_points(T, corners))
    assert valid.all()
    uv = uv + measurement_noise_factor * PIXEL_SIGMA_PX * rng.normal(size=uv.shape)
    index = np.arange(len(uv))
    return [
        MeasurementGroup(
            "camera",
            placement_index,
            "pattern_corner",
            _keypoint_columns("pattern_corner", placement_index, index, PIXEL_SIGMA_PX, uv),
        )
    ]


def _draw_returns(rng, world, target, T, k, noise, n=180):
    """Points of the side that faces the lidar, in rings by height, noise along the beam."""
    if isinstance(target, Board):
        q = target.lift(np.column_stack([rng.uniform(-0.45, 0.45, (n, 2)), np.zeros(n)]))
    else:
        sensor, r = invert_pose(T)[:3, 3], target.radius
        around = np.arctan2(sensor[2], sensor[1]) + rng.uniform(-1.0, 1.0, n)
        along = rng.uniform(-0.37, 0.37, n)
        q = np.column_stack([along, r * np.cos(around), r * np.sin(around)])
    p = transform_points(T, q)
    ring = np.argsort(np.argsort(p[:, 2])) * N_RINGS // n
    longer = noise * RANGE_SIGMA_M * rng.normal(size=n) + world.range_bias_m[ring]
    if isinstance(target, Board):
        longer += world.black_range_m * is_black(q)
    columns = {}
    if world.weak_range_m is not None:
        intensity = np.random.default_rng(k).uniform(0, 100, n)
        longer += world.weak_range_m * (0.5 - intensity / 100)
        columns["intensity"] = intensity
    p = p * (1 + longer / np.linalg.norm(p, axis=1))[:, None]
    return _keypoint_columns("target_surface", k, ring, RANGE_SIGMA_M, xyz=p) | columns


def is_black(q):
    """Which points (n, 3) lie on squares of the board that are black if the first one is: written
    out, 7 by 6 squares of 80 mm from (-0.28, -0.24) on."""
    i, j = np.floor((q[:, 0] + 0.28) / 0.08), np.floor((q[:, 1] + 0.24) / 0.08)
    return (i >= 0) & (i < 7) & (j >= 0) & (j < 6) & ((i + j) % 2 == 0)


def _draw_crossings(rng, target, T, k, noise, n=6):
    """Rays on the edges of a board, each off in azimuth by up to half a step of the scan."""
    share = rng.uniform(0.1, 0.9, (4, n, 1))
    ends = target.outline_edges()[:, :, None]
    q = target.lift((ends[:, 0] + share * (ends[:, 1] - ends[:, 0])).reshape(-1, 3))
    p = transform_points(T, q)
    ray = p / np.linalg.norm(p, axis=1)[:, None]
    turn = AZIMUTH_STEP_RAD * noise * rng.uniform(-0.5, 0.5, len(ray))
    ray = (so3_exp(turn[:, None] * [0.0, 0, 1]) @ ray[..., None])[..., 0]
    return _keypoint_columns(
        "board_outline", k, np.arange(len(ray)), AZIMUTH_STEP_RAD / np.sqrt(12), xyz=ray
    )


def _keypoint_columns(kind, k, index, sigma, uv=None, xyz=None):
    n = len(index)
    return {
        "view": np.full(n, k),
        "stamp_ns": np.zeros(n, int),
        "target": np.full(n, ""),
        "placement": np.full(n, k),
        "kind": np.full(n, kind),
        "feature_index": index,
        "xyz": np.full((n, 3), np.nan) if xyz is None else xyz,
        "uv": np.full((n, 2), np.nan) if uv is None else uv,
        "sigma": np.full(n, sigma),
        "whitening": np.tile([1.0, 0.0, 1.0], (n, 1)),
        "intensity": np.full(n, np.nan),
    }
