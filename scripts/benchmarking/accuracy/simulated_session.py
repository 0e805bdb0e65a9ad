"""What the pipeline made of one simulated session, and the simulator's own account of it."""

import argparse
import json
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from benchmarking.accuracy.accuracy_cases import AccuracyRow
from calib.geometry.se3 import invert_pose, pose_from_xyz_quat
from calib.io.config import validate_and_complete
from calib.io.parquet_tables import read_table
from calib.io.pose_block import pose_from_config
from calib.io.table_schemas import CAMERA_VIEWS_SCHEMA, LIDAR_VIEWS_SCHEMA, PLACEMENTS_SCHEMA
from calib.sensors.lidar.lidar_model import LidarModel
from calib.sensors.sensor_models import sensor_model_from_config
from calib.targets.target_shapes import target_from_config
from calib.views.windows import is_in_view_cone
from simulate import draw_sessions, parse_simulation_arguments
from simulation.config_and_truth import make_rig_config, make_target_config
from simulation.sensors.camera_exposure import Shutter
from simulation.sensors.image_renderer import compute_ray_grid
from simulation.sensors.scan_patterns import Firing
from simulation.session_recording import SessionTruth, render_session_image

NOISE_ARGUMENT_NAMES = ("range_noise_m", "image_noise", "mcs_noise_m", "mcs_noise_deg")
VIEW_SCHEMAS = {"camera": CAMERA_VIEWS_SCHEMA, "lidar": LIDAR_VIEWS_SCHEMA}


@dataclass(frozen=True)
class SimulatedSession:
    """One sensor and one target in one session, with noise that is yet to be drawn.

    session: of the simulator (record.Session), its arguments with that noise; options: what the
    stages read of a config that states the noise; placements, views: columns of the tables;
    content: by placement, what a sensor without noise meets there (`window` or `picture`).
    """

    truth: SessionTruth
    sensor: str
    target: str
    options: dict[str, Any]
    placement_columns: dict[str, np.ndarray]
    view_columns: dict[str, np.ndarray]
    guess_json: dict[str, Any]
    exact_data: dict[int, Any]

    @property
    def T_robot_sensor(self) -> ndarray:
        """The true pose (4, 4); nothing but the judgement of a result may ask for it."""
        return self.truth.rig.T_robot_sensor[self.sensor]

    @property
    def sensor_model(self) -> LidarModel:
        return sensor_model_from_config(self.options["sensor"])


def load_simulated_session(
    results_folder: Path,
    log_folder: Path,
    settings: dict[str, Any],
    row: AccuracyRow,
    noise_arguments: list[str],
) -> SimulatedSession:
    """The Recording of the folder of a session's results and of that of its simulated log.

    settings: the config of the run, complete; row: of the benchmark, for sensor and target;
    noise_arguments: arguments of simulate.py that make the noise to be drawn."""
    arguments = json.loads((log_folder / "truth.json").read_text())["arguments"]
    loud = {
        key: getattr(parse_simulation_arguments(["-", *noise_arguments]), key)
        for key in NOISE_ARGUMENT_NAMES
    }
    args = Namespace(**(arguments | loud))
    placements, _, _ = read_table(results_folder / "placements.parquet", PLACEMENTS_SCHEMA)
    kind = "camera" if row.is_camera else "lidar"
    views, _, _ = read_table(results_folder / row.sensor / "views.parquet", VIEW_SCHEMAS[kind])
    guess = json.loads((results_folder / row.sensor / "guess.json").read_text())
    return make_simulated_session(args, row.sensor, row.target, settings, placements, views, guess)


def make_simulated_session(
    arguments: argparse.Namespace,
    sensor: str,
    target: str,
    settings: dict[str, Any],
    placements: dict[str, np.ndarray],
    views: dict[str, np.ndarray],
    guess: dict[str, Any],
) -> SimulatedSession:
    """The Recording of arguments of simulate.py, the noise among them, and of what the pipeline
    made of such a log: columns of placements and views, content of guess.json."""
    (session,), guesses = draw_sessions(arguments)
    described = validate_and_complete(
        "rig", make_rig_config(session.rig, guesses, arguments), "rig"
    )
    written = validate_and_complete("target", make_target_config(target, arguments), "target")
    (name,) = set(placements["target"].tolist())
    block = described["sensors"][sensor]
    options = {
        "name": sensor,
        "sensor": block,
        "sensors": {sensor: block},
        "targets": {name: written},
        "mocap": described["mocap"],
        **{k: settings[k] for k in ("crop", "extract", "associate", "solve")},
    }
    whole = SimulatedSession(session, sensor, target, options, placements, views, guess, {})
    meet = render_exact_image if block["kind"] == "camera" else compute_window_firing
    for k in sorted(set(views["placement"][views["kept"]].tolist())):
        whole.exact_data[k] = meet(whole, k)
    return whole


def select_kept_views(session: SimulatedSession, placement: int) -> ndarray:
    """Rows of the kept views of a placement."""
    views = session.view_columns
    return np.flatnonzero(views["kept"] & (views["placement"] == placement))


def placement_time_span(session: SimulatedSession, placement: int) -> tuple[int, int]:
    """Start and end of a placement, ns."""
    row = np.flatnonzero(session.placement_columns["placement"] == placement)[0]
    start_ns, end_ns = (int(session.placement_columns[k][row]) for k in ("start_ns", "end_ns"))
    return start_ns, end_ns


def compute_window_firing(session: SimulatedSession, placement: int) -> tuple[Firing, ndarray]:
    """Beams (n, 3) of a turn around where the guess expects the target, the time of each after the
    first, ns, and its ring."""
    options, table = session.options, session.placement_columns
    row = np.flatnonzero(table["placement"] == placement)[0]
    T_robot_body = pose_from_xyz_quat(table["xyz"][row], table["quat"][row])
    (config_of,) = options["targets"].values()
    T_sensor_robot = invert_pose(np.array(session.guess_json["T_robot_sensor"]["matrix"]))
    T = T_sensor_robot @ T_robot_body @ pose_from_config(config_of["T_body_target"])
    spec = session.truth.rig.lidar_spec(session.sensor)
    firing = spec.scan_pattern.make_firing(np.deg2rad(spec.sector_deg), 0)
    margin = options["crop"]["margin_sigma"] * np.array(session.guess_json["sigma"])
    flat = firing.beam_directions.reshape(-1, 3)
    inside = is_in_view_cone(flat, target_from_config(config_of), T, margin)
    column, ring = np.divmod(np.flatnonzero(inside), firing.beam_directions.shape[1])
    return Firing(flat[inside][:, None], firing.column_time_ns[column]), ring.astype(np.int32)


def render_exact_image(recording: SimulatedSession, placement: int) -> np.ndarray:
    """Unrounded image (height, width, 3) of a placement without noise."""
    session, args = recording.truth, recording.truth.arguments
    view = compute_ray_grid(session.rig.camera_models[recording.sensor])
    shutter = Shutter(
        lambda t, points: render_session_image(session, recording.sensor, view, t, points),
        *(session.placement_times_ns, args.exposure_s, args.blur_px),
    )
    t = recording.view_columns["stamp_ns"][select_kept_views(recording, placement)[0]]
    return shutter.capture_image(int(t)).astype(np.float32)
