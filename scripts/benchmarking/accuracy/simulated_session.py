"""One simulated session: the results of the pipeline, and the truth of the simulator."""

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
from calib.sensors.sensor_models import SensorModel, sensor_model_from_config
from calib.targets.target_shapes import target_from_config
from calib.views.crop_windows import is_in_view_cone
from simulate import draw_sessions, parse_simulation_arguments
from simulation.config_and_truth import make_rig_config, make_target_config
from simulation.sensors.camera_exposure import Shutter
from simulation.sensors.image_renderer import compute_ray_grid
from simulation.sensors.scan_patterns import Firing
from simulation.session_recording import SessionTruth, render_session_image

NOISE_ARGUMENT_NAMES = (
    *("range_noise_m", "image_noise", "mcs_noise_m", "mcs_noise_deg"),
    *("mcs_wander_m", "mcs_wander_deg", "mcs_wander_s"),
)
VIEW_SCHEMAS = {"camera": CAMERA_VIEWS_SCHEMA, "lidar": LIDAR_VIEWS_SCHEMA}


@dataclass(frozen=True)
class SimulatedSession:
    """One sensor and one target in one session, ready for noise draws.

    truth: of the simulator, with the noise to draw in its arguments; options: of the stages;
    placement_columns, view_columns: of placements.parquet and views.parquet; guess_json: content of
    guess.json; exact_data: data of the sensor without noise by placement, from
    compute_window_firing or render_exact_image.
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
        """The true pose (4, 4), only for computing the error of a result."""
        return self.truth.rig.T_robot_sensor[self.sensor]

    @property
    def sensor_model(self) -> SensorModel:
        """The camera or lidar of the config."""
        return sensor_model_from_config(self.options["sensor"])


def load_simulated_session(
    results_folder: Path,
    log_folder: Path,
    settings: dict[str, Any],
    row: AccuracyRow,
    noise_arguments: list[str],
) -> SimulatedSession:
    """Load a session from its results and its simulated log.

    settings: complete config of the run; row: of the accuracy table, for sensor and target;
    noise_arguments: arguments of simulate.py for the noise to draw.
    """
    arguments = json.loads((log_folder / "truth.json").read_text())["arguments"]
    noise = {
        key: getattr(parse_simulation_arguments(["-", *noise_arguments]), key)
        for key in NOISE_ARGUMENT_NAMES
    }
    args = Namespace(**(arguments | noise))
    placements, _, _ = read_table(results_folder / "placements.parquet", PLACEMENTS_SCHEMA)
    kind = "camera" if row.is_camera else "lidar"
    views, _, _ = read_table(results_folder / row.sensor / "views.parquet", VIEW_SCHEMAS[kind])
    guess = json.loads((results_folder / row.sensor / "guess.json").read_text())
    return make_simulated_session(
        args,
        row.sensor,
        row.target,
        settings,
        placements=placements,
        views=views,
        guess=guess,
    )


def make_simulated_session(
    arguments: argparse.Namespace,
    sensor: str,
    target: str,
    settings: dict[str, Any],
    *,
    placements: dict[str, np.ndarray],
    views: dict[str, np.ndarray],
    guess: dict[str, Any],
) -> SimulatedSession:
    """Make a session from the arguments of simulate.py and the results of the pipeline.

    arguments: with the noise to draw; settings: complete config of the run; placements, views:
    columns of the tables; guess: content of guess.json.
    """
    (session,), guesses = draw_sessions(arguments)
    rig_config = validate_and_complete(
        "rig", make_rig_config(session.rig, guesses, arguments), "rig"
    )
    target_config = validate_and_complete("target", make_target_config(target, arguments), "target")
    (name,) = set(placements["target"].tolist())
    options = _stage_options(sensor, rig_config, {name: target_config}, settings)
    simulated = SimulatedSession(
        truth=session,
        sensor=sensor,
        target=target,
        options=options,
        placement_columns=placements,
        view_columns=views,
        guess_json=guess,
        exact_data={},
    )
    make_exact_data = (
        render_exact_image if options["sensor"]["kind"] == "camera" else compute_window_firing
    )
    for k in sorted(set(views["placement"][views["kept"]].tolist())):
        simulated.exact_data[k] = make_exact_data(simulated, k)
    return simulated


def _stage_options(
    sensor: str,
    rig_config: dict[str, Any],
    targets: dict[str, Any],
    settings: dict[str, Any],
) -> dict[str, Any]:
    """Return the options of extract and solve for one sensor; targets: configs by name."""
    block = rig_config["sensors"][sensor]
    return {
        "name": sensor,
        "sensor": block,
        "sensors": {sensor: block},
        "targets": targets,
        "mocap": rig_config["mocap"],
        **{k: settings[k] for k in ("crop", "extract", "associate", "solve")},
    }


def select_kept_views(session: SimulatedSession, placement: int) -> ndarray:
    """Return the rows of the kept views of a placement."""
    views = session.view_columns
    return np.flatnonzero(views["kept"] & (views["placement"] == placement))


def placement_time_span(session: SimulatedSession, placement: int) -> tuple[int, int]:
    """Return start and end of a placement, ns."""
    row = np.flatnonzero(session.placement_columns["placement"] == placement)[0]
    start_ns, end_ns = (int(session.placement_columns[k][row]) for k in ("start_ns", "end_ns"))
    return start_ns, end_ns


def compute_window_firing(session: SimulatedSession, placement: int) -> tuple[Firing, ndarray]:
    """Return the beams of one scan near the target, and the ring (n,) of each.

    Near: in the crop window around the target's pose according to the initial guess.
    """
    options, table = session.options, session.placement_columns
    row = np.flatnonzero(table["placement"] == placement)[0]
    T_robot_body = pose_from_xyz_quat(table["xyz"][row], table["quat"][row])
    (target_config,) = options["targets"].values()
    T_sensor_robot = invert_pose(np.array(session.guess_json["T_robot_sensor"]["matrix"]))
    T = T_sensor_robot @ T_robot_body @ pose_from_config(target_config["T_body_target"])
    spec = session.truth.rig.lidar_spec(session.sensor)
    firing = spec.scan_pattern.make_firing(np.deg2rad(spec.sector_deg), 0)
    margin = options["crop"]["margin_sigma"] * np.array(session.guess_json["sigma"])
    flat = firing.beam_directions.reshape(-1, 3)
    inside = is_in_view_cone(flat, target_from_config(target_config), T, margin)
    column, ring = np.divmod(np.flatnonzero(inside), firing.beam_directions.shape[1])
    return Firing(flat[inside][:, None], firing.column_time_ns[column]), ring.astype(np.int32)


def render_exact_image(recording: SimulatedSession, placement: int) -> np.ndarray:
    """Return the image (height, width, 3) of a placement without noise and without rounding."""
    session, args = recording.truth, recording.truth.arguments
    view = compute_ray_grid(session.rig.camera_models[recording.sensor])
    shutter = Shutter(
        lambda t, points: render_session_image(session, recording.sensor, view, t, points),
        *(session.placement_times_ns, args.exposure_s, args.blur_px),
    )
    t = recording.view_columns["stamp_ns"][select_kept_views(recording, placement)[0]]
    return shutter.capture_image(int(t)).astype(np.float32)
