"""The rig, the targets and what was measured of them, in the robot's frame, as data for a view."""

from dataclasses import dataclass

import numpy as np

from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.geometry.se3 import transform_points
from calib.io.parquet_tables import concatenate_columns, select_rows
from calib.io.table_schemas import RESIDUALS_SCHEMA
from calib.report.sections.extrinsics import initial_guess_pose
from calib.report.sections.residual_tables import residuals_by_kind, select_inlier_rows
from calib.report.sections.view_coverage import transform_residual_points
from calib.sensors.sensor_models import camera_from_config
from calib.targets.target_shapes import target_from_config

MAX_POINTS = 2500  # of a sensor
GLYPH_LENGTH_M = 0.15  # length of what is drawn of a sensor
N_CIRCLE_CORNERS = 24  # corners of a circle


@dataclass(frozen=True)
class SceneSensor:
    """One sensor: T_robot_sensor (4, 4) by the result and by the first guess, or None; its members
    (n, 3), m, sensor frame, and their residuals (n,) in σ."""

    name: str
    kind: str
    result: np.ndarray
    guess: np.ndarray
    inlier_points: np.ndarray
    standardized_residuals: np.ndarray


def collect_scene_sensors(run):
    """[Seen] of every sensor with a pose."""
    out = []
    for name, sensor in run.sensors.items():
        T = run.T_robot_sensor(name)
        if T is not None:
            points, sigmas = sample_inlier_points(run, name)
            guess = initial_guess_pose(sensor)
            out.append(SceneSensor(name, sensor["kind"], T, guess, points, sigmas))
    return out


def sample_inlier_points(run, name):
    """Members (n, 3), m, sensor frame, evenly chosen, and their residuals (n,) in σ."""
    camera = run.sensors[name]["kind"] == "camera"
    unit = "px" if camera else "m"
    kinds = residuals_by_kind(run, name).items()
    parts = [select_inlier_rows(c) for k, c in kinds if unit == RESIDUAL_KINDS[k].UNIT]
    parts = [p for p in parts if len(p["weight"])]
    if not parts:
        return np.zeros((0, 3)), np.zeros(0)
    c = concatenate_columns(parts, RESIDUALS_SCHEMA)
    c = select_rows(c, np.arange(0, len(c["weight"]), -(-len(c["weight"]) // MAX_POINTS)))
    r = c["value"] / c["sigma"][:, None]
    sigmas = r[:, 0] if np.all(r[:, 1] == 0) else np.linalg.norm(r, axis=1) / np.sqrt(2)
    if not camera:
        return transform_residual_points(run, name, c), sigmas
    # A pixel has no depth: that of the target where it was seen.
    rays, ok = camera_from_config(run.options["sensors"][name]).unproject(c["measured"][:, :2])
    return (rays * c["range_m"][:, None])[ok], sigmas[ok]


def collect_target_lines(run):
    """[(k, 3)] lines, m, robot frame: every target at every placement that was used."""
    used = set()
    for kinds in run.residuals_by_sensor.values():
        for columns in kinds.values():
            c = select_inlier_rows(columns)
            used |= set(zip(c["session"].tolist(), c["placement"].tolist(), strict=True))
    out = []
    for session, placement in sorted(used):
        p = run.sessions[session].placements
        row = np.flatnonzero(np.asarray(p["placement"]) == placement)[0]
        target = target_from_config(run.options["targets"][str(p["target"][row])])
        T = run.T_robot_target(session, placement)
        out += [transform_points(T, line) for line in trace_target_outline(target)]
    return out


def trace_target_outline(target):
    """[(k, 3)] lines, m, target frame, that show a target's shape."""
    if len(target.outline_edges()):
        flat = np.vstack([target.vertices, target.vertices[:1]])
        return [np.column_stack([flat, np.zeros(len(flat))])]
    if hasattr(target, "radius"):
        angle = np.linspace(0, 2 * np.pi, N_CIRCLE_CORNERS)
        ring = target.radius * np.column_stack([np.cos(angle), np.sin(angle)])
        half = target.length / 2
        ends = [np.column_stack([np.full(N_CIRCLE_CORNERS, x), ring]) for x in (-half, half)]
        quarters = range(0, N_CIRCLE_CORNERS - 1, N_CIRCLE_CORNERS // 4)
        return ends + [np.stack([ends[0][i], ends[1][i]]) for i in quarters]
    low, high = target.point_template.xyz.min(0), target.point_template.xyz.max(0)
    return [np.array([low, high])]


def trace_sensor_glyph(kind):
    """[(k, 3)] lines, m, sensor frame: a camera's field of view along z, a lidar's axes."""
    if kind == "camera":
        w, h = 0.5 * GLYPH_LENGTH_M, 0.35 * GLYPH_LENGTH_M
        face = np.array(
            [
                [-w, -h, GLYPH_LENGTH_M],
                [w, -h, GLYPH_LENGTH_M],
                [w, h, GLYPH_LENGTH_M],
                [-w, h, GLYPH_LENGTH_M],
            ]
        )
        return [np.vstack([face, face[:1]])] + [np.stack([np.zeros(3), p]) for p in face]
    return [np.stack([np.zeros(3), GLYPH_LENGTH_M * axis]) for axis in np.eye(3)]


def scene_3d_json(run):
    """What the page's script draws, plain lists of m: {sensors, targets}; None without a pose.

    Lines are [[x], [y], [z]] with null between one and the next.
    """
    seen = collect_scene_sensors(run)
    if not seen:
        return None
    told = []
    for s in seen:
        poses = {"result": s.result, "guess": s.guess}
        at = {n: None if T is None else _sensor_at_pose_json(s, T) for n, T in poses.items()}
        sigmas = np.round(np.clip(s.standardized_residuals, -9, 9), 1).tolist()
        told.append({"name": s.name, "kind": s.kind, "sigma": sigmas} | at)
    return {"sensors": told, "targets": _join_lines(collect_target_lines(run))}


def _sensor_at_pose_json(scene_sensor, T):
    """Where a sensor, its glyph and its points lie by T (4, 4)."""
    lines = [transform_points(T, line) for line in trace_sensor_glyph(scene_sensor.kind)]
    points = transform_points(T, scene_sensor.inlier_points)
    return {
        "origin": _round_to_mm(T[:3, 3]),
        "lines": _join_lines(lines),
        "points": _xyz_columns(points),
    }


def _xyz_columns(points):
    return [_round_to_mm(column) for column in np.reshape(points, (-1, 3)).T]


def _round_to_mm(values):
    """Metres in steps of a millimetre, which keeps the page small."""
    return (np.round(values, 3) + 0.0).tolist()


def _join_lines(lines):
    """Three columns of many lines, null between them."""
    out = [[], [], []]
    for line in lines:
        for column, values in zip(out, _xyz_columns(line), strict=True):
            column += [*values, None]
    return out
