"""Fresh noise on a recorded session, through the stages' own functions again.

A draw takes every sample of the MCS anew, turns the pattern of the scans by a share of its step at
every placement, so that the crossings of an outline lie elsewhere between two beams, and puts fresh
noise on every range or pixel. Then come the stages' own functions: mean poses, extraction from the
guess, the joint estimate. None of them is given the truth, which only serves to judge the result.
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
from calib.sensors.camera.images.image_messages import decode_png, encode_png
from gate import average_still_pose
from simulation.sensors.camera_exposure import digitize_image
from simulation.sensors.lidar_scanner import scan_scene
from simulation.sensors.mocap_errors import MCS_PERIOD_NS, measure_body_poses
from simulation.session_recording import mcs_time_span
from simulation.world.ray_casting import PosedScene

DRAW_TOLERANCE = {
    "tolerance_m": 1e-7,
    "tolerance_rad": 1e-7,
}  # a hundredth of the smallest σ at most


def redraw_and_estimate(session: SimulatedSession, seed: int) -> DrawResult:
    """The Draw of one seed; its pose is None where nothing was found."""
    rng = np.random.default_rng([session.truth.arguments.seed, seed])
    table = redraw_placements(session, rng)
    setup, start = build_draw_setup(session, table, redraw_views(session, rng))
    if not setup.groups:
        return DrawResult(None, None)
    stops = iteration_limits(setup, session.options["solve"] | DRAW_TOLERANCE)
    result = estimate_poses(setup, start, **stops)
    T = result.state.T_robot_sensor[session.sensor]
    spread = result.solve_result.covariance[:6, :6]
    error = se3_log(invert_pose(T) @ session.T_robot_sensor)
    return DrawResult(error, spread)


def build_draw_setup(
    session: SimulatedSession,
    placement_columns: dict[str, np.ndarray],
    views: dict[str, np.ndarray],
) -> tuple[Setup, dict[str, np.ndarray]]:
    """The Setup, and the poses to start from, that the stages make of the columns of
    placements.parquet and views.parquet."""
    options, name = session.options, session.sensor
    job = make_extraction_context(
        options, session.sensor_model, placement_columns, session.guess_json
    )
    extraction = SENSOR_EXTRACTORS[options["sensor"]["kind"]].extract(job, views)
    drawn = SessionKeypoints(
        session="",
        keypoints=extraction.keypoints | {"sensor": np.full(extraction.n_keypoints, name)},
        placements=job.placements,
        T_robot_sensor={name: extraction.T_robot_sensor},
    )
    return build_setup([drawn], {}, options)


def compute_draw_references(session: SimulatedSession) -> tuple[np.ndarray, np.ndarray]:
    """(with, without) outlines: the covariances (6, 6) of the reference for draws of a recording.

    Of one draw's data: the information hardly depends on their noise.
    """
    rng = np.random.default_rng(session.truth.arguments.seed)
    setup, _ = build_draw_setup(
        session, redraw_placements(session, rng), redraw_views(session, rng)
    )
    true = {session.sensor: session.T_robot_sensor}
    found = compute_cramer_rao_bound(setup, true, session.truth.arguments.range_noise_m)
    return found.covariance[session.sensor], found.covariance_without_outlines[session.sensor]


def redraw_placements(
    recording: SimulatedSession, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Columns of placements.parquet with every sample of the MCS anew."""
    session = recording.truth
    start, end = mcs_time_span(session.placement_times_ns)
    t = np.arange(start, end + 1, MCS_PERIOD_NS)
    gap = round(recording.options["mocap"]["max_gap_s"] * NS_PER_S)
    poses = (measure_body_poses(session, rng, name, t) for name in ("robot", recording.target))
    relative = relative_trajectory(*(Trajectory(t, T, gap) for T in poses))
    sigma = pose_sigma_from_config(recording.options["mocap"]["pose_sigma"])
    table = {k: np.array(v) for k, v in recording.placement_columns.items()}
    for i in np.flatnonzero(table["kind"] == "still"):
        found = average_still_pose(relative, (table["start_ns"][i], table["end_ns"][i]), sigma)
        for key, value in found.items():
            table[key][i] = value
    return table


def redraw_views(session: SimulatedSession, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Columns of views.parquet with fresh noise on every kept view."""
    views = {k: list(v) if isinstance(v, list) else v for k, v in session.view_columns.items()}
    anew = _redraw_image if session.options["sensor"]["kind"] == "camera" else _redraw_scan
    for k in sorted(session.exact_data):
        fresh = anew(session, k, rng)
        for i in select_kept_views(session, k):
            for key, value in fresh(i).items():
                views[key][i] = value
    return views


def _redraw_scan(
    recording: SimulatedSession, placement: int, rng: np.random.Generator
) -> Callable[[int], dict[str, Any]]:
    """Function of a row of views: its columns in a scan with noise; the phase is one for all."""
    session = recording.truth
    firing, ring = recording.exact_data[placement]
    step = recording.sensor_model.azimuth_step
    turn = so3_exp([0.0, 0.0, step * rng.uniform(-0.5, 0.5)])
    firing = firing._replace(beam_directions=firing.beam_directions @ turn.T)
    when = np.array([placement_time_span(recording, placement)[0]])
    T = {k: np.reshape(v, (-1, 4, 4))[0] for k, v in session.surface_poses(when).items()}
    T_world_lidar = session.true_body_poses("robot", when)[0] @ recording.T_robot_sensor
    echoes = scan_scene(PosedScene(session.scene, T, T_world_lidar), firing)
    seen = echoes.has_return[:, 0]
    beams, distance = firing.beam_directions[seen, 0], echoes.distance_m[seen, 0]
    rest = {"ring": ring[seen], "point_time_ns": firing.column_time_ns[seen]}

    def fresh(row: int) -> dict[str, Any]:
        ranges = distance + session.arguments.range_noise_m * rng.standard_normal(len(distance))
        return rest | {"xyz": (beams * ranges[:, None]).astype(np.float32).reshape(-1)}

    return fresh


def _redraw_image(
    session: SimulatedSession, placement: int, rng: np.random.Generator
) -> Callable[[int], dict[str, Any]]:
    """Function of a row of views: its columns in an image with noise."""
    views, whole = session.view_columns, session.exact_data[placement]
    encoding = session.truth.rig.camera_spec(session.sensor).encoding
    noise = session.truth.arguments.image_noise

    def fresh(row: int) -> dict[str, Any]:
        height, width = decode_png(views["png"][row]).shape[:2]
        u, v = views["u0"][row], views["v0"][row]
        region = whole[v : v + height, u : u + width]
        return {"png": encode_png(digitize_image(region, encoding, noise, rng))}

    return fresh
