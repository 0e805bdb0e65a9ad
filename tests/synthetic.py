"""Setups whose measurements are made by formula, of targets, lenses and mounts as they are built,
which need not be what the Setup says of them."""

from dataclasses import dataclass, field, replace

import numpy as np

from calib.estimation import estimation_problem, solver
from calib.geometry import se3
from calib.sensors.camera.camera_model import Camera
from calib.sensors.lidar import lidar_model
from calib.targets.board import Board
from calib.targets.cylinder import Cylinder
from calib.targets.patterns.checkerboard import Checkerboard

LENS = (800.0, 800.0, 449.5, 349.5, -0.1, 0.02, 0.0005, -0.0003)
CAMERA = Camera("radtan", LENS, (900, 700))
STEP = np.radians(0.2)
LIDAR = lidar_model.Lidar(STEP, np.radians(2.0), None, None, (0.3, 100.0), 0.01)
SQUARE = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
BOARD = Board(SQUARE, 0.0, Checkerboard(6, 5, 0.08, (-0.2, -0.16)))
CYLINDER = Cylinder(0.8, 0.1)
TARGETS = {"board": BOARD, "cylinder": CYLINDER}
MODELS = {"camera": CAMERA, "lidar": LIDAR}
ASSOCIATE = {"gate_sigma": 6.0, "edge_margin_m": 0.02, "min_cosine": 0.3}
FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # both look along the robot's x
TRUE = {
    "camera": se3.pose(FORWARD, [0.2, 0.1, 0.5]),
    "lidar": se3.from_rpy([0.1, -0.05, 0.7], [0.02, -0.03, 0.05]),
}
MCS_SIGMA = np.repeat([1e-4, np.radians(0.01)], 3)
PIXEL, RANGE = 0.05, 0.01  # px, m: noise, which is also what the Setup starts from
RINGS = 12


@dataclass(frozen=True)
class World:
    """What is there: targets, lens, T_body_target by target (identity) and by how much, m, the
    lidar's ranges are too long, for every ring."""

    targets: dict = field(default_factory=lambda: TARGETS)
    camera: Camera = CAMERA
    mounts: dict = field(default_factory=dict)
    too_long: np.ndarray = field(default_factory=lambda: np.zeros(RINGS))


def pattern_scaled(factor):
    """Targets with a pattern of squares so much larger, about its middle."""
    p = BOARD.pattern
    grown = Checkerboard(6, 5, factor * p.square, tuple(factor * np.array(p.first)))
    return TARGETS | {"board": replace(BOARD, pattern=grown)}


def outline_scaled(x, y):
    """Targets with an outline so much wider and higher."""
    return TARGETS | {"board": replace(BOARD, vertices=SQUARE * [x, y])}


def zoomed(factor):
    """The camera with a focal length so much longer."""
    return replace(CAMERA, params=(factor * LENS[0], factor * LENS[1], *LENS[2:]))


def setup(seed, layout, world=None, mcs=1.0, noise=1.0):
    """A Setup of placements [(target, axis of a cylinder or None)]; mcs and noise: times theirs.

    The camera sees boards, the lidar everything. Placements are the same for every seed.
    """
    world = world or World()
    rng, where = np.random.default_rng(seed), np.random.default_rng(99)
    places, groups = [], []
    for k, (name, axis) in enumerate(layout):
        T_robot_target = _placed(where, name, axis)
        errors = se3.se3_exp(mcs * MCS_SIGMA * rng.normal(size=(2, 6)))
        T_target_body = se3.inverse(world.mounts.get(name, np.eye(4)))
        said = errors[0] @ T_robot_target @ T_target_body @ se3.inverse(errors[1])
        places.append(estimation_problem.Placement("s", name, said, np.eye(4), MCS_SIGMA, start=k))
        groups += _groups(rng, world, k, name, T_robot_target, noise)
    models = {n: m for n, m in MODELS.items() if any(g.sensor == n for g in groups)}
    return estimation_problem.Setup(models, TARGETS, places, groups, ASSOCIATE, {})


def solved(setup, rounds=30):
    """The Result of so many rounds at most from a start that is off by about 5 mm and 0.3°."""
    start = {n: TRUE[n] @ se3.se3_exp(np.full(6, 0.005)) for n in setup.models}
    return solver.estimate(setup, start, rounds, 1e-5, 1e-5, 100.0)


def _placed(rng, name, axis):
    """A target 1.5 to 3 m before the robot, turned at random; a cylinder's axis may be given."""
    at = rng.uniform([1.5, -0.4, 0.3], [3.0, 0.4, 0.9])
    if name == "board":
        turn = se3.so3_exp(rng.uniform(-0.6, 0.6, 3))
        return se3.pose(turn @ np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]]), at)
    x = rng.normal(size=3) if axis is None else np.asarray(axis, float)
    x /= np.linalg.norm(x)
    y = np.cross(x, [0.3, 0.5, 0.8])
    y /= np.linalg.norm(y)
    return se3.pose(np.column_stack([x, y, np.cross(x, y)]), at)


def _groups(rng, world, k, name, T_robot_target, noise):
    found = measured(rng, world, "lidar", k, name, T_robot_target, noise)
    if name == "board":
        found += measured(rng, world, "camera", k, name, T_robot_target, noise)
    return found


def measured(rng, world, sensor, k, name, T_robot_target, noise=1.0):
    """The Groups of what one of the sensors measures of a target."""
    target, T = world.targets[name], se3.inverse(TRUE[sensor]) @ T_robot_target
    if sensor == "lidar":
        found = [
            estimation_problem.Group(
                "lidar", k, "surface", _returns(rng, world, target, T, k, noise)
            )
        ]
        if name == "board":
            found.append(
                estimation_problem.Group("lidar", k, "edge", _crossings(rng, target, T, k, noise))
            )
        return found
    uv, valid = world.camera.project(se3.transform(T, target.pattern.corners()))
    assert valid.all()
    uv = uv + noise * PIXEL * rng.normal(size=uv.shape)
    index = np.arange(len(uv))
    return [estimation_problem.Group("camera", k, "corner", _table("corner", k, index, PIXEL, uv))]


def _returns(rng, world, target, T, k, noise, n=180):
    """Points of the side that faces the lidar, in rings by height, noise along the beam."""
    if isinstance(target, Board):
        q = np.column_stack([rng.uniform(-0.45, 0.45, (n, 2)), np.zeros(n)])
    else:
        sensor, r = se3.inverse(T)[:3, 3], target.radius
        around = np.arctan2(sensor[2], sensor[1]) + rng.uniform(-1.0, 1.0, n)
        along = rng.uniform(-0.37, 0.37, n)
        q = np.column_stack([along, r * np.cos(around), r * np.sin(around)])
    p = se3.transform(T, q)
    ring = np.argsort(np.argsort(p[:, 2])) * RINGS // n
    longer = noise * RANGE * rng.normal(size=n) + world.too_long[ring]
    p = p * (1 + longer / np.linalg.norm(p, axis=1))[:, None]
    return _table("surface", k, ring, RANGE, xyz=p)


def _crossings(rng, target, T, k, noise, n=6):
    """Rays on the edges of a board, each off in azimuth by up to half a step of the scan."""
    share = rng.uniform(0.1, 0.9, (4, n, 1))
    ends = target.edges()[:, :, None]
    q = (ends[:, 0] + share * (ends[:, 1] - ends[:, 0])).reshape(-1, 3)
    p = se3.transform(T, q)
    ray = p / np.linalg.norm(p, axis=1)[:, None]
    turn = STEP * noise * rng.uniform(-0.5, 0.5, len(ray))
    ray = (se3.so3_exp(turn[:, None] * [0.0, 0, 1]) @ ray[..., None])[..., 0]
    return _table("edge", k, np.arange(len(ray)), STEP / np.sqrt(12), xyz=ray)


def _table(kind, k, index, sigma, uv=None, xyz=None):
    n = len(index)
    return {
        "view": np.full(n, k),
        "t": np.zeros(n, int),
        "target": np.full(n, ""),
        "placement": np.full(n, k),
        "kind": np.full(n, kind),
        "index": index,
        "xyz": np.full((n, 3), np.nan) if xyz is None else xyz,
        "uv": np.full((n, 2), np.nan) if uv is None else uv,
        "sigma": np.full(n, sigma),
        "whiten": np.tile([1.0, 0.0, 1.0], (n, 1)),
    }
