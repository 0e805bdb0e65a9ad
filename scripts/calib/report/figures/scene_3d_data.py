"""The rig, the targets and what was measured of them, in the robot's frame, as data for a view."""

from dataclasses import dataclass

import numpy as np

from calib.estimation.residuals.residual_registry import KINDS
from calib.geometry import se3
from calib.io import parquet_tables, table_schemas
from calib.report.sections import extrinsics, residual_tables, view_coverage
from calib.sensors import sensor_models
from calib.targets import target_shapes

MOST_POINTS = 2500  # of a sensor
AXIS_M = 0.15  # length of what is drawn of a sensor
ROUND = 24  # corners of a circle


@dataclass(frozen=True)
class Seen:
    """One sensor: T_robot_sensor (4, 4) by the result and by the first guess, or None; its members
    (n, 3), m, sensor frame, and their residuals (n,) in σ."""

    name: str
    kind: str
    result: np.ndarray
    guess: np.ndarray
    points: np.ndarray
    sigmas: np.ndarray


def sensors(run):
    """[Seen] of every sensor with a pose."""
    out = []
    for name, sensor in run.sensors.items():
        T = run.T_robot_sensor(name)
        if T is not None:
            points, sigmas = members(run, name)
            guess = extrinsics.guess(sensor)
            out.append(Seen(name, sensor["kind"], T, guess, points, sigmas))
    return out


def members(run, name):
    """Members (n, 3), m, sensor frame, evenly chosen, and their residuals (n,) in σ."""
    camera = run.sensors[name]["kind"] == "camera"
    unit = "px" if camera else "m"
    kinds = residual_tables.of(run, name).items()
    parts = [residual_tables.members(c) for k, c in kinds if unit == KINDS[k].UNIT]
    parts = [p for p in parts if len(p["weight"])]
    if not parts:
        return np.zeros((0, 3)), np.zeros(0)
    c = parquet_tables.concatenate(parts, table_schemas.RESIDUALS)
    c = parquet_tables.select(
        c, np.arange(0, len(c["weight"]), -(-len(c["weight"]) // MOST_POINTS))
    )
    r = c["value"] / c["sigma"][:, None]
    sigmas = r[:, 0] if np.all(r[:, 1] == 0) else np.linalg.norm(r, axis=1) / np.sqrt(2)
    if not camera:
        return view_coverage.in_sensor(run, name, c), sigmas
    # A pixel has no depth: that of the target where it was seen.
    rays, ok = sensor_models.camera(run.options["sensors"][name]).unproject(c["measured"][:, :2])
    return (rays * c["range"][:, None])[ok], sigmas[ok]


def shapes(run):
    """[(k, 3)] lines, m, robot frame: every target at every placement that was used."""
    used = set()
    for kinds in run.by_sensor.values():
        for columns in kinds.values():
            c = residual_tables.members(columns)
            used |= set(zip(c["session"].tolist(), c["placement"].tolist(), strict=True))
    out = []
    for session, placement in sorted(used):
        p = run.sessions[session].placements
        row = np.flatnonzero(np.asarray(p["placement"]) == placement)[0]
        target = target_shapes.from_config(run.options["targets"][str(p["target"][row])])
        T = run.T_robot_target(session, placement)
        out += [se3.transform(T, line) for line in outline(target)]
    return out


def outline(target):
    """[(k, 3)] lines, m, target frame, that show a target's shape."""
    if len(target.edges()):
        flat = np.vstack([target.vertices, target.vertices[:1]])
        return [np.column_stack([flat, np.zeros(len(flat))])]
    if hasattr(target, "radius"):
        angle = np.linspace(0, 2 * np.pi, ROUND)
        ring = target.radius * np.column_stack([np.cos(angle), np.sin(angle)])
        half = target.length / 2
        ends = [np.column_stack([np.full(ROUND, x), ring]) for x in (-half, half)]
        quarters = range(0, ROUND - 1, ROUND // 4)
        return ends + [np.stack([ends[0][i], ends[1][i]]) for i in quarters]
    low, high = target.points.template.min(0), target.points.template.max(0)
    return [np.array([low, high])]


def glyph(kind):
    """[(k, 3)] lines, m, sensor frame: a camera's field of view along z, a lidar's axes."""
    if kind == "camera":
        w, h = 0.5 * AXIS_M, 0.35 * AXIS_M
        face = np.array([[-w, -h, AXIS_M], [w, -h, AXIS_M], [w, h, AXIS_M], [-w, h, AXIS_M]])
        return [np.vstack([face, face[:1]])] + [np.stack([np.zeros(3), p]) for p in face]
    return [np.stack([np.zeros(3), AXIS_M * axis]) for axis in np.eye(3)]


def content(run):
    """What the page's script draws, plain lists of m: {sensors, targets}; None without a pose.

    Lines are [[x], [y], [z]] with null between one and the next.
    """
    seen = sensors(run)
    if not seen:
        return None
    told = []
    for s in seen:
        poses = {"result": s.result, "guess": s.guess}
        at = {n: None if T is None else _at(s, T) for n, T in poses.items()}
        sigmas = np.round(np.clip(s.sigmas, -9, 9), 1).tolist()
        told.append({"name": s.name, "kind": s.kind, "sigma": sigmas} | at)
    return {"sensors": told, "targets": _lines(shapes(run))}


def _at(seen, T):
    """Where a sensor, its glyph and its points lie by T (4, 4)."""
    lines = [se3.transform(T, line) for line in glyph(seen.kind)]
    points = se3.transform(T, seen.points)
    return {"origin": _millimetres(T[:3, 3]), "lines": _lines(lines), "points": _columns(points)}


def _columns(points):
    return [_millimetres(column) for column in np.reshape(points, (-1, 3)).T]


def _millimetres(values):
    """Metres in steps of a millimetre, which keeps the page small."""
    return (np.round(values, 3) + 0.0).tolist()


def _lines(lines):
    """Three columns of many lines, null between them."""
    out = [[], [], []]
    for line in lines:
        for column, values in zip(out, _columns(line), strict=True):
            column += [*values, None]
    return out
