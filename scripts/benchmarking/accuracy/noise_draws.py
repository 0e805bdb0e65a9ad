"""Put new noise on a recorded session and run the functions of the stages on it again.

A draw makes new noise for every MCS sample and for every range or pixel. It also rotates the scan
pattern by a random part of its step at every placement, so that the outline crossings move between
two beams. Then the functions of the stages follow: mean poses, extraction from the initial guess,
joint estimate. They do not get the truth; it is only used to compute the error of the result.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarking.accuracy.cramer_rao_bound import compute_cramer_rao_bound
from benchmarking.accuracy.draw_statistics import DrawResult
from benchmarking.accuracy.simulated_session import (
    SimulatedSession,
    placement_time_span,
    select_kept_views,
)
from calib.estimation.estimation_problem import Setup
from calib.estimation.problem_assembly import SessionKeypoints, build_setup, iteration_limits
from calib.estimation.solver import estimate_poses
from calib.extraction.extraction_inputs import make_extraction_context
from calib.extraction.extractor_registry import SENSOR_EXTRACTORS
from calib.geometry.se3 import invert_pose, se3_log, so3_exp
from calib.geometry.units import NS_PER_S
from calib.io.pose_block import pose_sigma_from_config
from calib.mocap.body_trajectory import Trajectory, relative_trajectory
from calib.mocap.placements import average_still_pose
from calib.sensors.camera.images.image_messages import decode_png, encode_png
from calib.sensors.lidar.lidar_model import LidarModel
from simulation.sensors.camera_exposure import digitize_image
from simulation.sensors.lidar_scanner import scan_scene
from simulation.sensors.mocap_errors import MCS_PERIOD_NS, measure_body_poses
from simulation.session_recording import mcs_time_span
from simulation.world.ray_casting import PosedScene

# At most a hundredth of the smallest σ.
DRAW_TOLERANCE = {"tolerance_m": 1e-7, "tolerance_rad": 1e-7}


def redraw_and_estimate(session: SimulatedSession, seed: int) -> DrawResult:
    """Estimate a session with the noise of one seed.

    The result has no error and no covariance if extraction finds no keypoints.
    """
    rng = np.random.default_rng([session.truth.arguments.seed, seed])
    table = redraw_placements(session, rng)
    setup, start = build_draw_setup(session, table, redraw_views(session, rng))
    if not setup.groups:
        return DrawResult(None, None)
    limits = iteration_limits(setup, session.options["solve"] | DRAW_TOLERANCE)
    result = estimate_poses(setup, start, **limits)
    T = result.state.T_robot_sensor[session.sensor]
    covariance = result.solved.covariance[:6, :6]
    error = se3_log(invert_pose(T) @ session.T_robot_sensor)
    return DrawResult(error, covariance)


def build_draw_setup(
    session: SimulatedSession,
    placement_columns: dict[str, np.ndarray],
    views: dict[str, np.ndarray],
) -> tuple[Setup, dict[str, np.ndarray]]:
    """Run extraction; return the setup of the estimate and the poses from which it starts.

    placement_columns, views: columns of placements.parquet and views.parquet.
    """
    options, name = session.options, session.sensor
    context = make_extraction_context(
        options, session.sensor_model, placement_columns, session.guess_json
    )
    extraction = SENSOR_EXTRACTORS[options["sensor"]["kind"]].extract(context, views)
    T = extraction.T_robot_sensor
    drawn = SessionKeypoints(
        session="",
        keypoints=extraction.keypoints | {"sensor": np.full(extraction.n_keypoints, name)},
        placements=context.placements,
        T_robot_sensor={} if T is None else {name: T},
    )
    return build_setup([drawn], {}, options)


def compute_draw_references(session: SimulatedSession) -> tuple[np.ndarray, np.ndarray]:
    """Return the reference covariances (6, 6), with and without outline crossings.

    Computed from the data of one draw, because the information hardly depends on the noise.
    """
    rng = np.random.default_rng(session.truth.arguments.seed)
    setup, _ = build_draw_setup(
        session, redraw_placements(session, rng), redraw_views(session, rng)
    )
    T_true = {session.sensor: session.T_robot_sensor}
    bound = compute_cramer_rao_bound(setup, T_true, session.truth.arguments.range_noise_m)
    return bound.covariance[session.sensor], bound.covariance_without_outlines[session.sensor]


def redraw_placements(
    recording: SimulatedSession, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Return the columns of placements.parquet from newly drawn MCS samples."""
    session = recording.truth
    start, end = mcs_time_span(session.placement_times_ns)
    t = np.arange(start, end + 1, MCS_PERIOD_NS)
    gap = round(recording.options["mocap"]["max_gap_s"] * NS_PER_S)
    poses = (measure_body_poses(session, rng, name, t) for name in ("robot", recording.target))
    relative = relative_trajectory(*(Trajectory(t, T, gap) for T in poses))
    sigma = pose_sigma_from_config(recording.options["mocap"]["pose_sigma"])
    table = {k: np.array(v) for k, v in recording.placement_columns.items()}
    for i in np.flatnonzero(table["kind"] == "still"):
        mean_pose = average_still_pose(relative, (table["start_ns"][i], table["end_ns"][i]), sigma)
        for key, value in mean_pose.items():
            table[key][i] = value
    return table


def redraw_views(session: SimulatedSession, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the columns of views.parquet with new noise on every kept view."""
    views = {k: list(v) if isinstance(v, list) else v for k, v in session.view_columns.items()}
    redraw = _redraw_image if session.options["sensor"]["kind"] == "camera" else _redraw_scan
    for k in sorted(session.exact_data):
        fresh = redraw(session, k, rng)
        for i in select_kept_views(session, k):
            for key, value in fresh(i).items():
                views[key][i] = value
    return views


def _redraw_scan(
    recording: SimulatedSession, placement: int, rng: np.random.Generator
) -> Callable[[int], dict[str, Any]]:
    """Return a function that makes the columns of one view, by row, from a scan with new noise.

    All scans of the placement have the same random rotation of the scan pattern.
    """
    session = recording.truth
    firing, ring = recording.exact_data[placement]
    step = LidarModel.from_config(recording.options["sensor"]).azimuth_step
    turn = so3_exp([0.0, 0.0, step * rng.uniform(-0.5, 0.5)])
    firing = firing._replace(beam_directions=firing.beam_directions @ turn.T)
    when = np.array([placement_time_span(recording, placement)[0]])
    T = {k: np.reshape(v, (-1, 4, 4))[0] for k, v in session.surface_poses(when).items()}
    T_world_lidar = session.true_body_poses("robot", when)[0] @ recording.T_robot_sensor
    echoes = scan_scene(PosedScene(session.scene, T, T_world_lidar), firing)
    has_return = echoes.has_return[:, 0]
    beams, distance = firing.beam_directions[has_return, 0], echoes.distance_m[has_return, 0]
    columns = {
        "ring": ring[has_return],
        "point_time_ns": firing.column_time_ns[has_return],
        "intensity": np.full(has_return.sum(), np.nan, np.float32),
    }

    def fresh(row: int) -> dict[str, Any]:
        ranges = distance + session.arguments.range_noise_m * rng.standard_normal(len(distance))
        return columns | {"xyz": (beams * ranges[:, None]).astype(np.float32).reshape(-1)}

    return fresh


def _redraw_image(
    session: SimulatedSession, placement: int, rng: np.random.Generator
) -> Callable[[int], dict[str, Any]]:
    """Return a function that makes the columns of one view, by row, of an image with new noise."""
    views, whole = session.view_columns, session.exact_data[placement]
    encoding = session.truth.rig.camera_spec(session.sensor).encoding
    noise = session.truth.arguments.image_noise

    def fresh(row: int) -> dict[str, Any]:
        height, width = decode_png(views["png"][row]).shape[:2]
        u, v = views["u0"][row], views["v0"][row]
        region = whole[v : v + height, u : u + width]
        return {"png": encode_png(digitize_image(region, encoding, noise, rng))}

    return fresh
