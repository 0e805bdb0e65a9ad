"""Check that the covariance covers the error when all noise is exactly as modelled.

Keypoints get errors from the noise model itself: returns along the beam; outline crossings anywhere
between two beams, the same in every scan; corners and contour points in pixels; MCS poses from
their priors, with one robot error for all targets of the same placement.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from benchmarking.accuracy.draw_statistics import (
    CONFIDENCE_LEVEL,
    DrawResult,
    normalized_squared_errors,
)
from benchmarking.accuracy.exact_observations import OBSERVERS
from calib.estimation.estimation_problem import Placement
from calib.estimation.measurement_groups import make_still_placements
from calib.estimation.problem_assembly import SessionKeypoints, build_setup
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import invert_pose, pose_to_quat, se3_exp, se3_log
from calib.io.config import validate_and_complete
from calib.targets.board import Board
from calib.targets.cylinder import Cylinder
from calib.targets.target_shapes import target_from_config
from simulate import draw_sessions, parse_simulation_arguments
from simulation.config_and_truth import make_rig_config, make_target_config
from simulation.session_recording import SessionTruth

N_VIEWS_PER_PLACEMENT = 2  # scans or images of a placement
N_MCS_SAMPLES = 60  # MCS poses averaged over a placement
MAX_START_ERROR = 2e-4  # m, rad, per axis: error of the poses from which the estimate starts
NOISE_ARGUMENTS = "--range-noise-m 0.008 --mcs-noise-m 0.00015 --mcs-noise-deg 0.02"
NOISE_ARGUMENTS += " --mcs-bias-m 0.00005 --mcs-bias-deg 0.005"
COVERAGE_CASES = {  # title: arguments of simulate.py, sensors
    "lidar, board and cylinder": ("--rig round --placements 10", ("velodyne",)),
    "camera, board": ("--rig sim --targets board --placements 10", ("camera",)),
    "two lidars and two cameras": (
        "--rig demo --placements 9",
        ("front_lidar", "left_camera", "rear_lidar", "right_camera"),
    ),
}


@dataclass(frozen=True)
class CoverageCase:
    """A rig and its placements, with exact measurements.

    T_robot_sensor: true poses (4, 4) by sensor; options: of solve; measurements: columns of
    pairs.parquet by session; placements: by session and number.
    """

    T_robot_sensor: dict[str, np.ndarray]
    options: dict[str, Any]
    measurements: dict[str, dict[str, np.ndarray]]
    placements: dict[str, dict[int, Placement]]


def make_coverage_case(arguments: str, sensor_names: Sequence[str]) -> CoverageCase:
    """Make a case of some sensors of a simulated rig.

    arguments: of simulate.py, as in COVERAGE_CASES.
    """
    args = parse_simulation_arguments(["-", *NOISE_ARGUMENTS.split(), *arguments.split()])
    sessions, guesses = draw_sessions(args)
    rig = sessions[0].rig
    rig_config = validate_and_complete("rig", make_rig_config(rig, guesses, args), "rig")
    target_configs = {
        n: validate_and_complete("target", make_target_config(n, args), n) for n in args.targets
    }
    minimal = {"sessions": {"any": {"rig": "any", "log": "any"}}}
    settings = validate_and_complete("config", minimal, "config")
    options = {
        "sensors": {n: rig_config["sensors"][n] for n in sensor_names},
        "targets": target_configs,
        "mocap": rig_config["mocap"],
        **{k: settings[k] for k in ("associate", "solve")},
    }
    return CoverageCase(
        T_robot_sensor={n: rig.T_robot_sensor[n] for n in sensor_names},
        options=options,
        measurements={s.name: exact_measurements(s, options) for s in sessions},
        placements={s.name: exact_placements(s, options) for s in sessions},
    )


def exact_placements(session: SessionTruth, options: dict[str, Any]) -> dict[int, Placement]:
    """Return the placements by number with exact poses: all of the first target, then the next."""
    names, count = sorted(options["targets"]), len(session.placement_times_ns)
    T_robot_world = invert_pose(session.placement_poses["robot"])
    T = np.concatenate([T_robot_world @ session.placement_poses[n] for n in names])
    times = np.tile(session.placement_times_ns, (len(names), 1))
    table = {
        "placement": np.arange(len(T)),
        "target": np.repeat(names, count),
        "kind": np.full(len(T), "still"),
        "start_ns": times[:, 0],
        "end_ns": times[:, 1],
        "xyz": T[:, :3, 3],
        "quat": pose_to_quat(T),
        "mean_pose_sigma_factor": np.full(len(T), N_MCS_SAMPLES**-0.5),
        "residual_drift": np.zeros((len(T), 6)),
        **{
            f"{name}_slow_{quantity}": np.zeros((len(T), 6))
            for name in ("robot", "body")
            for quantity in ("sigma", "time_s")
        },
    }
    return make_still_placements(
        table, session.name, targets=options["targets"], mocap_noise=options["mocap"]
    )


def exact_measurements(session: SessionTruth, options: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return the columns of pairs.parquet with the exact measurements of all sensors."""
    names, count, parts = sorted(options["targets"]), len(session.placement_times_ns), []
    for number in range(count * len(names)):
        target, k = names[number // count], number % count
        shape = target_from_config(options["targets"][target])
        assert isinstance(shape, Board | Cylinder), "no other shape has exact observations"
        for sensor, block in options["sensors"].items():
            observed = OBSERVERS[block["kind"]](
                session,
                sensor_name=sensor,
                sensor_block=block,
                target_name=target,
                shape=shape,
                placement_index=k,
            )
            for columns in observed:
                labels = {"sensor": sensor, "target": target, "placement": number}
                for view in range(N_VIEWS_PER_PLACEMENT):
                    view_number = N_VIEWS_PER_PLACEMENT * number + view
                    parts.append(_with_constant_columns(columns, labels | {"view": view_number}))
    return {key: np.concatenate([p[key] for p in parts]) for key in parts[0]}


def _with_constant_columns(
    columns: dict[str, np.ndarray], constants: dict[str, Any]
) -> dict[str, np.ndarray]:
    n = len(columns["feature_index"])
    return columns | {k: np.full(n, v) for k, v in constants.items()}


def draw_coverage_error(case: CoverageCase, seed: int) -> DrawResult:
    """Estimate a case with the noise of one seed; return the joint error of all sensors.

    The error and covariance are those of all sensors, ordered by name.
    """
    rng = np.random.default_rng([2, seed])
    start = {
        n: T @ se3_exp(rng.uniform(-MAX_START_ERROR, MAX_START_ERROR, 6))
        for n, T in case.T_robot_sensor.items()
    }
    sessions = [
        SessionKeypoints(
            session=name,
            keypoints=add_measurement_noise(columns, case, rng),
            placements=add_mocap_errors(case.placements[name], rng),
            T_robot_sensor=start,
        )
        for name, columns in case.measurements.items()
    ]
    setup, start = build_setup(sessions, {}, case.options)
    result = estimate_poses(
        setup,
        start,
        max_rounds=case.options["solve"]["max_rounds"],
        tolerance_m=1e-6,
        tolerance_rad=1e-6,
        initial_noise_factor=10.0,
    )
    names = sorted(case.T_robot_sensor)
    covariance = result.solved.covariance[: 6 * len(names), : 6 * len(names)]
    T = result.state.T_robot_sensor
    errors = [se3_log(invert_pose(T[n]) @ case.T_robot_sensor[n]) for n in names]
    return DrawResult(np.concatenate(errors), covariance)


def add_measurement_noise(
    columns: dict[str, np.ndarray], case: CoverageCase, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Return the columns with an independent error on every measurement."""
    kind, n = columns["kind"], len(columns["kind"])
    along, pixels = rng.standard_normal(n), rng.standard_normal((n, 2))
    sigma, xyz, uv = columns["sigma"], columns["xyz"].copy(), columns["uv"].copy()
    rows = kind == "target_surface"
    unit = xyz[rows] / np.linalg.norm(xyz[rows], axis=1)[:, None]
    xyz[rows] += (sigma * along)[rows, None] * unit
    rows = kind == "board_outline"
    xyz[rows] = rotate_rays(xyz[rows], draw_crossing_errors(columns, rows, rng) * sigma[rows])
    rows = (kind == "pattern_corner") | (kind == "cylinder_limb")
    uv[rows] += sigma[rows, None] * pixels[rows]
    return columns | {"xyz": xyz, "uv": uv}


def draw_crossing_errors(
    columns: dict[str, np.ndarray], is_crossing: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draw uniform errors (m,) with σ = 1 for outline crossings.

    A crossing that another scan of the same placement repeats gets the same error.
    """
    crossings = zip(
        *(columns[k][is_crossing].tolist() for k in ("sensor", "placement", "xyz")), strict=True
    )
    cells: dict[tuple[str, int, tuple[float, ...]], int] = {}
    index = [cells.setdefault((s, p, tuple(ray)), len(cells)) for s, p, ray in crossings]
    return np.sqrt(3) * rng.uniform(-1, 1, len(cells))[index]


def rotate_rays(rays: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
    """Return rays (n, 3) rotated about z, along the scan, by angles (n,)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = rays.T
    return np.column_stack([c * x - s * y, s * x + c * y, z])


def add_mocap_errors(
    placements: dict[int, Placement], rng: np.random.Generator
) -> dict[int, Placement]:
    """Return placements with MCS errors; placements of the same rest share the robot's error."""
    robots = {p.robot_rest: rng.standard_normal(6) for _, p in sorted(placements.items())}
    out = {}
    for number, p in sorted(placements.items()):
        errors = p.mocap_sigma * np.stack([robots[p.robot_rest], rng.standard_normal(6)])
        robot, body = se3_exp(errors)
        out[number] = replace(p, T_robot_body=invert_pose(robot) @ p.T_robot_body @ body)
    return out


@dataclass(frozen=True)
class CoverageResult:
    """How often the covariance of one case covers the error, over many draws.

    By sensor, and for `all` together: share_covered: share of the ellipsoids (CONFIDENCE_LEVEL)
    that contain the truth; mean_nees: mean NEES over its degrees of freedom; n_dof: these.
    """

    title: str
    n_draws: int
    share_covered: dict[str, float]
    mean_nees: dict[str, float]
    n_dof: dict[str, int]


def compute_coverage(
    title: str, sensor_names: Sequence[str], draws: list[DrawResult]
) -> CoverageResult:
    """Compute the coverage from the draws of one case with these sensors."""
    sensor_names = sorted(sensor_names)
    blocks = {n: slice(6 * i, 6 * i + 6) for i, n in enumerate(sensor_names)}
    if len(sensor_names) > 1:
        blocks["all"] = slice(0, 6 * len(sensor_names))
    results = [
        (d.error, d.covariance) for d in draws if d.error is not None and d.covariance is not None
    ]
    share_covered, mean_nees, n_dof = {}, {}, {}
    for name, block in blocks.items():
        nees = normalized_squared_errors(
            np.array([e[block] for e, _ in results]),
            np.array([c[block, block] for _, c in results]),
        )
        n_dof[name] = block.stop - block.start
        share_covered[name] = float(np.mean(nees < chi2.ppf(CONFIDENCE_LEVEL, n_dof[name])))
        mean_nees[name] = float(nees.mean() / n_dof[name])
    return CoverageResult(title, len(draws), share_covered, mean_nees, n_dof)
