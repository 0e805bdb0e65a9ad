"""What of a sensor's view held targets, how far away, how inclined: from the members alone."""

from dataclasses import dataclass

import numpy as np

from calib.estimation.residuals.residual_registry import KINDS
from calib.geometry import se3
from calib.io import parquet_tables, table_schemas
from calib.report import number_format
from calib.report.sections import residual_tables
from calib.targets import target_shapes

GRID = 10  # cells per side of an image
SECTOR_DEG = 10  # of a lidar's azimuth


@dataclass(frozen=True)
class Coverage:
    """Members of one sensor, and its placements.

    uv (n, 2), px, or azimuth and elevation, deg, in the sensor's frame; range (n,), m; incidence
    (n,), deg, empty where not known; normals and axes (k, 3), unit, robot frame, one a placement.
    """

    at: np.ndarray
    range: np.ndarray
    incidence: np.ndarray
    normals: np.ndarray
    axes: np.ndarray


def of_sensor(run, sensor):
    """The Coverage of one sensor; None without a member."""
    kinds = {k: residual_tables.members(c) for k, c in residual_tables.of(run, sensor).items()}
    unit = "px" if run.sensors[sensor]["kind"] == "camera" else "m"
    parts = [c for k, c in kinds.items() if unit == KINDS[k].UNIT and len(c["weight"])]
    if not parts:
        return None
    c = parquet_tables.concatenate(parts, table_schemas.RESIDUALS)
    at = c["measured"][:, :2] if unit == "px" else angles(in_sensor(run, sensor, c))
    cosine = c["cosine"][c["cosine"] > 0]
    incidence = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
    return Coverage(at, c["range"], incidence, *directions(run, c))


def in_sensor(run, sensor, columns):
    """Measured points (n, 3), sensor frame, m, of a lidar's residuals."""
    out = np.zeros((len(columns["view"]), 3))
    for rows in residual_tables.groups(columns["session"], columns["placement"]):
        session, placement = str(columns["session"][rows[0]]), int(columns["placement"][rows[0]])
        T = run.T_sensor_target(sensor, session, placement)
        T = T["solved"] if T["solved"] is not None else T["guess"]
        out[rows] = se3.transform(T, columns["measured"][rows])
    return out


def angles(p):
    """Azimuth and elevation (n, 2), deg, of points (n, 3)."""
    flat = np.hypot(p[:, 0], p[:, 1])
    return np.degrees(np.column_stack([np.arctan2(p[:, 1], p[:, 0]), np.arctan2(p[:, 2], flat)]))


def directions(run, columns):
    """Normals (k, 3) of flat targets and axes (m, 3) of the others, robot frame, by placement."""
    flat, axes = [], []
    for rows in residual_tables.groups(columns["session"], columns["placement"]):
        session, placement = str(columns["session"][rows[0]]), int(columns["placement"][rows[0]])
        T = run.T_robot_target(session, placement)
        config = run.options["targets"][str(columns["target"][rows[0]])]
        if len(target_shapes.from_config(config).edges()):
            flat.append(T[:3, 2])
        else:
            # An axis has no sign; half of the sphere holds all of them.
            axes.append(T[:3, 0] if T[0, 0] >= 0 else -T[:3, 0])
    return np.reshape(flat, (-1, 3)), np.reshape(axes, (-1, 3))


def widest(normals):
    """Largest angle, deg, between two directions (k, 3); None of fewer than two."""
    if len(normals) < 2:
        return None
    return float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1)).max()))


def row(run, sensor, found):
    """What the table says of one sensor."""
    config, told = run.options["sensors"][sensor], run.sensors[sensor]
    counts = {k: number_format.count(told[k]) for k in ("placements", "observations")}
    if found is None:
        return {"name": sensor, "found": False} | counts
    wide = {"normals": widest(found.normals), "axes": widest(found.axes)}
    wide = [f"{what} {number_format.number(w, 2)}°" for what, w in wide.items() if w is not None]
    return counts | {
        "name": sensor,
        "found": True,
        "share": image_share(found, config) if config["kind"] == "camera" else sectors(found),
        "range": between(found.range, "m"),
        "incidence": between(found.incidence, "°"),
        "directions": ", ".join(wide) or number_format.DASH,
        "normals": number_format.count(len(found.normals)),
        "axes": number_format.count(len(found.axes)),
    }


def image_share(found, config):
    """`41 of 100 cells of the image` in which a camera measured."""
    size = np.asarray(config["size_px"])
    cells = np.clip((found.at + 0.5) * GRID / size, 0, GRID - 1).astype(int)
    return f"{len(np.unique(cells, axis=0))} of {GRID**2} cells of the image"


def sectors(found):
    """`5 of 36 sectors of azimuth, elevation −12 to 9°` in which a lidar measured."""
    azimuth, elevation = found.at.T
    n = len(np.unique(np.floor(azimuth / SECTOR_DEG)))
    return f"{n} of {360 // SECTOR_DEG} sectors of azimuth, elevation {between(elevation, '°')}"


def between(values, unit):
    """`1.4 to 3.2 m`, or a dash of nothing."""
    if not len(values):
        return number_format.DASH
    # A line never breaks between a number and its unit.
    space = "" if unit == "°" else "\u00a0"
    low, high = number_format.number(values.min(), 2), number_format.number(values.max(), 2)
    return f"{low} to {high}{space}{unit}"
