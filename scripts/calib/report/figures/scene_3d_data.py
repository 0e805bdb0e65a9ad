"""The rig, the targets and the inliers in the robot frame, as data for the 3-D view."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.geometry.se3 import transform_points
from calib.io.parquet_tables import concatenate_columns, select_rows
from calib.io.table_schemas import RESIDUALS_SCHEMA
from calib.report.data.run_data import ReportRun
from calib.report.sections.coverage import transform_residual_points
from calib.report.sections.extrinsics import initial_guess_pose
from calib.report.sections.residuals import inliers_in_unit, select_inlier_rows
from calib.sensors.sensor_models import camera_from_config
from calib.targets.target_outline import trace_target_outline
from calib.targets.target_shapes import target_from_config

MAX_POINTS = 2500  # per sensor
MAX_SHOWN_SIGMA = 9
GLYPH_LENGTH_M = 0.15


@dataclass(frozen=True)
class SceneSensor:
    """One sensor with a pose.

    result, guess: T_robot_sensor (4, 4), the guess or None; inlier_points (n, 3), m, sensor frame;
    standardized_residuals (n,).
    """

    name: str
    kind: str
    result: np.ndarray
    guess: np.ndarray | None
    inlier_points: np.ndarray
    standardized_residuals: np.ndarray


def collect_scene_sensors(run: ReportRun) -> list[SceneSensor]:
    """Return all sensors with a pose."""
    sensors = []
    for name, block in run.sensors.items():
        T = run.T_robot_sensor(name)
        if T is not None:
            points, standardized = sample_inlier_points(run, name)
            guess = initial_guess_pose(block)
            sensors.append(SceneSensor(name, block["kind"], T, guess, points, standardized))
    return sensors


def sample_inlier_points(run: ReportRun, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return inliers (n, 3), m, sensor frame, at most MAX_POINTS, and their residuals (n,) in σ."""
    is_camera = run.sensors[name]["kind"] == "camera"
    parts = inliers_in_unit(run, name, "px" if is_camera else "m")
    if not parts:
        return np.zeros((0, 3)), np.zeros(0)
    inliers = concatenate_columns(parts, RESIDUALS_SCHEMA)
    step = -(-len(inliers["weight"]) // MAX_POINTS)
    inliers = select_rows(inliers, np.arange(0, len(inliers["weight"]), step))
    r = inliers["value"] / inliers["sigma"][:, None]
    has_one_component = np.all(r[:, 1] == 0)
    standardized = r[:, 0] if has_one_component else np.linalg.norm(r, axis=1) / np.sqrt(2)
    if not is_camera:
        return transform_residual_points(run, name, inliers), standardized
    # A pixel has no depth: take that of the target.
    camera = camera_from_config(run.options["sensors"][name])
    rays, is_valid = camera.unproject(inliers["measured"][:, :2])
    return (rays * inliers["range_m"][:, None])[is_valid], standardized[is_valid]


def collect_target_lines(run: ReportRun) -> list[np.ndarray]:
    """Return lines (k, 3), m, robot frame: the target of each placement with an inlier."""
    used: set[tuple[str, int]] = set()
    for kinds in run.residuals_by_sensor.values():
        for columns in kinds.values():
            inliers = select_inlier_rows(columns)
            sessions, placements = inliers["session"].tolist(), inliers["placement"].tolist()
            used |= set(zip(sessions, placements, strict=True))
    lines = []
    for session, placement in sorted(used):
        table = run.sessions[session].placements
        row = np.flatnonzero(np.asarray(table["placement"]) == placement)[0]
        target = target_from_config(run.options["targets"][str(table["target"][row])])
        T = run.T_robot_target(session, placement)
        lines += [transform_points(T, line) for line in trace_target_outline(target)]
    return lines


def trace_sensor_glyph(kind: str) -> list[np.ndarray]:
    """Return lines (k, 3), m, sensor frame: the field of view of a camera, the axes of a lidar."""
    if kind == "camera":
        w, h, z = 0.5 * GLYPH_LENGTH_M, 0.35 * GLYPH_LENGTH_M, GLYPH_LENGTH_M
        face = np.array([[-w, -h, z], [w, -h, z], [w, h, z], [-w, h, z]])
        return [np.vstack([face, face[:1]])] + [np.stack([np.zeros(3), p]) for p in face]
    return [np.stack([np.zeros(3), GLYPH_LENGTH_M * axis]) for axis in np.eye(3)]


def scene_3d_json(run: ReportRun) -> dict[str, Any] | None:
    """Return {sensors, targets} for scene.js, m, in the robot frame; None without a pose.

    Lines are [[x], [y], [z]] with null after each line.
    """
    sensors = collect_scene_sensors(run)
    if not sensors:
        return None
    blocks = []
    for sensor in sensors:
        clipped = np.clip(sensor.standardized_residuals, -MAX_SHOWN_SIGMA, MAX_SHOWN_SIGMA)
        block = {
            "name": sensor.name,
            "kind": sensor.kind,
            "standardized_residuals": np.round(clipped, 1).tolist(),
        }
        for by, T in (("result", sensor.result), ("guess", sensor.guess)):
            block[by] = None if T is None else _sensor_at_pose_json(sensor, T)
        blocks.append(block)
    return {"sensors": blocks, "targets": _join_lines(collect_target_lines(run))}


def _sensor_at_pose_json(sensor: SceneSensor, T: np.ndarray) -> dict[str, list]:
    """Return origin, glyph and inliers of a sensor by T_robot_sensor (4, 4)."""
    lines = [transform_points(T, line) for line in trace_sensor_glyph(sensor.kind)]
    return {
        "origin": _round_to_mm(T[:3, 3]),
        "lines": _join_lines(lines),
        "points": _xyz_columns(transform_points(T, sensor.inlier_points)),
    }


def _xyz_columns(points: np.ndarray) -> list[list[float]]:
    return [_round_to_mm(column) for column in np.reshape(points, (-1, 3)).T]


def _round_to_mm(values: np.ndarray) -> list[float]:
    """Round metres to millimetres, which keeps the page small."""
    return (np.round(values, 3) + 0.0).tolist()


def _join_lines(lines: list[np.ndarray]) -> list[list[float | None]]:
    """Return columns x, y, z of lines, with None after each line."""
    joined: list[list[float | None]] = [[], [], []]
    for line in lines:
        for column, values in zip(joined, _xyz_columns(line), strict=True):
            column += [*values, None]
    return joined
