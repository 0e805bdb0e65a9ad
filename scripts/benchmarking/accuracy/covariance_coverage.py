"""Does the covariance hold what it promises, where every measurement errs exactly as modelled?

Keypoints are drawn from the noise model itself: returns along the beam, crossings anywhere between
two beams and alike in every scan, corners and contour points in pixels, and the errors of the MCS
from their priors, the robot's shared by all targets at rest with it.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

import simulate
from benchmarking.accuracy import exact_observations
from benchmarking.accuracy.draw_statistics import LEVEL, Draw, squared
from calib.estimation import measurement_groups, problem_assembly, solver
from calib.geometry import se3
from calib.io import config
from calib.targets import target_shapes
from simulation import config_and_truth

VIEWS = 2  # scans or images of a placement
SAMPLES = 60  # MCS poses averaged over a placement
START = 2e-4  # m, rad: by how much, per axis, the poses are off from which it starts
NOISE = "--range-noise-m 0.008 --mcs-noise-m 0.00015 --mcs-noise-deg 0.02"
NOISE += " --mcs-bias-m 0.00005 --mcs-bias-deg 0.005"
CASES = {  # title: arguments of simulate.py, sensors
    "lidar, board and cylinder": ("--rig round --placements 10", ("velodyne",)),
    "camera, board": ("--rig sim --targets board --placements 10", ("camera",)),
    "two lidars and two cameras": (
        "--rig demo --placements 9",
        ("front_lidar", "left_camera", "rear_lidar", "right_camera"),
    ),
}


@dataclass(frozen=True)
class Geometry:
    """A rig and its placements, with all measurements exact.

    truth: T_robot_sensor by sensor; options: what solve reads; by session, pairs: columns, and
    places: Placements by number.
    """

    truth: dict
    options: dict
    pairs: dict
    places: dict


def geometry_of(arguments, names):
    """The Geometry of the sensors so named, as arguments of simulate.py make it (CASES)."""
    args = simulate.parse(["-", *NOISE.split(), *arguments.split()])
    sessions, guesses = simulate.draw(args)
    built = sessions[0].rig
    described = config.complete("rig", config_and_truth.rig_config(built, guesses, args), "rig")
    written = {
        n: config.complete("target", config_and_truth.target_config(n, args), n)
        for n in args.targets
    }
    some = {"sessions": {"any": {"rig": "any", "log": "any"}}}
    settings = config.complete("config", some, "config")
    options = {
        "sensors": {n: described["sensors"][n] for n in names},
        "targets": written,
        "mocap": described["mocap"],
        **{k: settings[k] for k in ("associate", "solve")},
    }
    pairs = {s.name: pairs_of(s, options) for s in sessions}
    places = {s.name: places_of(s, options) for s in sessions}
    return Geometry({n: built.sensors[n] for n in names}, options, pairs, places)


def places_of(session, options):
    """Placements by number with exact poses: `count` rests of each target in turn."""
    names, count = sorted(options["targets"]), len(session.times)
    T = [se3.inverse(session.knots["robot"]) @ session.knots[n] for n in names]
    T, times = np.concatenate(T), np.tile(session.times, (len(names), 1))
    table = {
        "placement": np.arange(len(T)),
        "target": np.repeat(names, count),
        "kind": np.full(len(T), "still"),
        "start": times[:, 0],
        "end": times[:, 1],
        "xyz": T[:, :3, 3],
        "quat": se3.to_quat(T),
        "pose_factor": np.full(len(T), SAMPLES**-0.5),
        "creep": np.zeros((len(T), 6)),
    }
    return measurement_groups.still(table, session.name, options["targets"], options["mocap"])


def pairs_of(session, options):
    """Columns of pairs.parquet of everything that is seen, exactly."""
    names, count, parts = sorted(options["targets"]), len(session.times), []
    for number in range(count * len(names)):
        target, k = names[number // count], number % count
        shape = target_shapes.from_config(options["targets"][target])
        for sensor, block in options["sensors"].items():
            sight = exact_observations.SENSORS[block["kind"]]
            for columns in sight(session, sensor, block, target, shape, k):
                about = {"sensor": sensor, "target": target, "placement": number}
                for view in range(VIEWS):
                    parts.append(_row(columns, about | {"view": VIEWS * number + view}))
    return {key: np.concatenate([p[key] for p in parts]) for key in parts[0]}


def _row(columns, about):
    n = len(columns["index"])
    return columns | {k: np.full(n, v) for k, v in about.items()}


def draw(case, seed):
    """The Draw of one seed of a Geometry, of all its sensors by name."""
    rng = np.random.default_rng([2, seed])
    start = {n: T @ se3.se3_exp(rng.uniform(-START, START, 6)) for n, T in case.truth.items()}
    notes = {n: {"T_robot_sensor": T} for n, T in start.items()}
    sessions = {
        name: (noisy(columns, case, rng), notes, shaken(case.places[name], rng))
        for name, columns in case.pairs.items()
    }
    setup, start = problem_assembly.setup_of(sessions, {}, case.options)
    limits = case.options["solve"]["max_rounds"], 1e-6, 1e-6
    result = solver.estimate(setup, start, *limits, noise=10.0)
    names = sorted(case.truth)
    found = result.solution.covariance[: 6 * len(names), : 6 * len(names)]
    T = result.state.T_robot_sensor
    errors = [se3.se3_log(se3.inverse(T[n]) @ case.truth[n]) for n in names]
    return Draw(np.concatenate(errors), found)


def noisy(columns, case, rng):
    """The columns with an error of its own for every measurement."""
    kind, n = columns["kind"], len(columns["kind"])
    along, pixels = rng.standard_normal(n), rng.standard_normal((n, 2))
    sigma, xyz, uv = columns["sigma"], columns["xyz"].copy(), columns["uv"].copy()
    rows = kind == "surface"
    unit = xyz[rows] / np.linalg.norm(xyz[rows], axis=1)[:, None]
    xyz[rows] += (sigma * along)[rows, None] * unit
    rows = kind == "edge"
    xyz[rows] = turned(xyz[rows], repeated(columns, rows, rng) * sigma[rows])
    rows = (kind == "corner") | (kind == "limb")
    uv[rows] += sigma[rows, None] * pixels[rows]
    return columns | {"xyz": xyz, "uv": uv}


def repeated(columns, rows, rng):
    """Uniform errors (m,) of unit σ of the chosen crossings, alike where a scan repeats one."""
    where = zip(*(columns[k][rows].tolist() for k in ("sensor", "placement", "xyz")), strict=True)
    cells = {}
    index = [cells.setdefault((s, p, tuple(ray)), len(cells)) for s, p, ray in where]
    return np.sqrt(3) * rng.uniform(-1, 1, len(cells))[index]


def turned(rays, angle):
    """Rays (n, 3) turned about z by angles (n,), rad: along the scan."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = rays.T
    return np.column_stack([c * x - s * y, s * x + c * y, z])


def shaken(places, rng):
    """Placements by number with errors of the MCS, the robot's alike for all at rest together."""
    robots = {p.rest: rng.standard_normal(6) for _, p in sorted(places.items())}
    out = {}
    for number, p in sorted(places.items()):
        errors = p.sigma * np.stack([robots[p.rest], rng.standard_normal(6)])
        robot, body = se3.se3_exp(errors)
        out[number] = replace(p, T_robot_body=se3.inverse(robot) @ p.T_robot_body @ body)
    return out


@dataclass(frozen=True)
class Coverage:
    """Over the draws of one case: how many; by sensor, and for `all` together, the share of LEVEL
    ellipsoids that hold the truth, the mean of NEES over its degrees of freedom, and these."""

    title: str
    count: int
    held: dict
    nees: dict
    size: dict


def coverage(title, names, draws):
    """The Coverage of Draws of the sensors so named."""
    names = sorted(names)
    blocks = {n: slice(6 * i, 6 * i + 6) for i, n in enumerate(names)}
    if len(names) > 1:
        blocks["all"] = slice(0, 6 * len(names))
    held, nees, size = {}, {}, {}
    for name, at in blocks.items():
        found = squared(
            np.array([d.error[at] for d in draws]), np.array([d.covariance[at, at] for d in draws])
        )
        size[name] = at.stop - at.start
        held[name] = float(np.mean(found < chi2.ppf(LEVEL, size[name])))
        nees[name] = float(found.mean() / size[name])
    return Coverage(title, len(draws), held, nees, size)
