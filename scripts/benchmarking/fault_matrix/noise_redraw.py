"""Put the noise of real rooms on the exact keypoints and poses of a run.

Motion capture gets white and slow noise per sample, and the rests are averaged and their noise is
measured again. Returns get noise along their beams; corners and contours scatter by the 0.3 px of
real images. Outline crossings keep the error that they have: that of the gaps between beams.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import solve
from benchmarking.fault_matrix.stage_runner import StageJob, select_jobs
from benchmarking.room_rigs import CORNER_SIGMA_PX
from calib.geometry.se3 import pose_from_xyz_quat, pose_to_quat, se3_exp
from calib.io.parquet_tables import Columns, read_table, write_table
from calib.io.pose_block import pose_sigma_from_config
from calib.io.table_schemas import (
    KEYPOINTS_SCHEMA,
    MOCAP_SCHEMA,
    PAIRS_SCHEMA,
    PLACEMENTS_SCHEMA,
)
from calib.mocap.body_trajectory import relative_trajectory, trajectory_from_columns
from calib.mocap.placements import measure_placement
from calib.mocap.rest_noise import describe_rest_noise, measure_body_noise
from calib.mocap.stillness import StillnessLimits
from simulation.sensors.mocap_errors import draw_gauss_markov

RANGE_KINDS = ("target_surface", "cylinder_cap")
PIXEL_KINDS = ("pattern_corner", "cylinder_limb")


def redraw_inputs(
    source: Path, out: Path, jobs: list[StageJob], noise: argparse.Namespace, seed: int
) -> None:
    """Write the tables that solve reads into folder out, with the noise of one seed.

    source: folder of a run without noise; noise: arguments of simulate.py.
    """
    (job,) = select_jobs(jobs, "solve")
    paths = solve.parse_arguments(job.arguments)
    gates = {g.arguments[g.arguments.index("--output") + 1]: g for g in select_jobs(jobs, "gate")}
    moving = iter(paths.moving_keypoints)
    for number, session in enumerate(paths.options["sessions"]):
        rng = np.random.default_rng([seed, number])
        mocap, status, notes = read_table(source / paths.mocap[number], MOCAP_SCHEMA)
        mocap = add_mocap_noise(mocap, noise, rng)
        write_result(out / paths.mocap[number], MOCAP_SCHEMA, mocap, status, notes)
        at = paths.placements[number]
        gate_options = read_options(gates[str(at)])
        columns, status, notes = read_table(source / at, PLACEMENTS_SCHEMA)
        columns, noise_notes = measure_placements(columns, mocap, gate_options)
        write_result(out / at, PLACEMENTS_SCHEMA, columns, status, notes | noise_notes)
        keypoints = [(paths.pairs[number], PAIRS_SCHEMA)]
        keypoints += [(next(moving), KEYPOINTS_SCHEMA) for _ in paths.options["used"][session]]
        for path, schema in keypoints:
            columns, status, notes = read_table(source / path, schema)
            columns = add_keypoint_noise(columns, noise.range_noise_m, rng)
            write_result(out / path, schema, columns, status, notes)


def read_options(job: StageJob) -> dict[str, Any]:
    """Return the options of a job."""
    words = job.arguments
    return dict(json.loads(words[words.index("--options") + 1]))


def write_result(path: Path, schema: Any, columns: Columns, status: Any, notes: Any) -> None:
    """Write a table into a folder that may not be there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_table(path, schema, columns, status, notes)


def add_mocap_noise(
    columns: Columns, noise: argparse.Namespace, rng: np.random.Generator
) -> Columns:
    """Return the columns of mocap.parquet with noise as simulate.py makes it, per body."""
    xyz, quat = columns["xyz"].copy(), columns["quat"].copy()
    white = np.repeat([noise.mcs_noise_m, np.deg2rad(noise.mcs_noise_deg)], 3)
    slow = np.append(np.full(3, noise.mcs_wander_m), np.deg2rad(noise.mcs_wander_deg))
    for body in sorted(set(columns["body"])):
        rows = np.flatnonzero((columns["body"] == body) & (columns["fault"] == ""))
        rows = rows[np.argsort(columns["stamp_ns"][rows], kind="stable")]
        t = columns["stamp_ns"][rows]
        T = np.stack([pose_from_xyz_quat(xyz[i], quat[i]) for i in rows])
        T = T @ se3_exp(white * rng.standard_normal((len(t), 6)))
        if slow.any():
            T = T @ se3_exp(slow * draw_gauss_markov(rng, t, noise.mcs_wander_s))
        xyz[rows], quat[rows] = T[:, :3, 3], pose_to_quat(T)
    return columns | {"xyz": xyz, "quat": quat}


def measure_placements(
    columns: Columns, mocap: Columns, options: dict[str, Any]
) -> tuple[Columns, dict[str, Any]]:
    """Return the columns of placements.parquet from other poses at the same times, and its notes.

    options: of stage gate.
    """
    settings, limits = options["mocap"], StillnessLimits.from_config(options["gate"])
    gap_s, robot_body = settings["max_gap_s"], options["body"]
    sigma = pose_sigma_from_config(settings["pose_sigma"])
    bodies = [robot_body, *options["targets"].values()]
    noise = measure_body_noise(mocap, bodies, limits, gap_s)
    used = noise if settings["use_measured_noise"] else {}
    robot = trajectory_from_columns(mocap, robot_body, gap_s)
    out = {k: v.copy() for k, v in columns.items()}
    for target, body in options["targets"].items():
        relative = relative_trajectory(robot, trajectory_from_columns(mocap, body, gap_s))
        slow_noise = {"robot": used.get(robot_body), "body": used.get(body)}
        for i in np.flatnonzero(columns["target"] == target):
            span = np.array([columns["start_ns"][i], columns["end_ns"][i]])
            row = measure_placement(columns["kind"][i], relative, span, sigma, slow_noise)
            for key, value in row.items():
                out[key][i] = value
    lines = [describe_rest_noise(name, n, settings) for name, n in noise.items()]
    measured = {name: n.to_dict() for name, n in noise.items()}
    return out, {"mocap_noise": measured, "mocap_notes": lines}


def add_keypoint_noise(columns: Columns, range_noise_m: float, rng: np.random.Generator) -> Columns:
    """Return keypoints with noise on returns along their beams, and on corners and contours."""
    xyz, uv = columns["xyz"].copy(), columns["uv"].copy()
    rows = np.isin(columns["kind"], RANGE_KINDS)
    distance = np.linalg.norm(xyz[rows], axis=1)[:, None]
    xyz[rows] *= 1 + range_noise_m * rng.standard_normal((int(rows.sum()), 1)) / distance
    rows = np.isin(columns["kind"], PIXEL_KINDS)
    uv[rows] += CORNER_SIGMA_PX * rng.standard_normal((int(rows.sum()), 2))
    return columns | {"xyz": xyz, "uv": uv}
