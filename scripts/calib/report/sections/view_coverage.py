"""What of a sensor's view held targets, how far away, how inclined: from the members alone."""

from dataclasses import dataclass

import numpy as np

from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.geometry.se3 import transform_points
from calib.io.parquet_tables import concatenate_columns
from calib.io.table_schemas import RESIDUALS_SCHEMA
from calib.report.number_format import DASH, format_count, format_number
from calib.report.sections.residual_tables import (
    group_rows_by_pair,
    residuals_by_kind,
    select_inlier_rows,
)
from calib.targets.target_shapes import target_from_config

N_GRID_CELLS = 10  # cells per side of an image
AZIMUTH_SECTOR_DEG = 10  # of a lidar's azimuth


@dataclass(frozen=True)
class ViewCoverage:
    """Members of one sensor, and its placements.

    uv (n, 2), px, or azimuth and elevation, deg, in the sensor's frame; range (n,), m; incidence
    (n,), deg, empty where not known; normals and axes (k, 3), unit, robot frame, one a placement.
    """

    view_coordinates: np.ndarray
    range_m: np.ndarray
    incidence_deg: np.ndarray
    normals: np.ndarray
    axes: np.ndarray


def compute_view_coverage(run, sensor):
    """The Coverage of one sensor; None without a member."""
    kinds = {k: select_inlier_rows(c) for k, c in residuals_by_kind(run, sensor).items()}
    unit = "px" if run.sensors[sensor]["kind"] == "camera" else "m"
    parts = [c for k, c in kinds.items() if unit == RESIDUAL_KINDS[k].UNIT and len(c["weight"])]
    if not parts:
        return None
    c = concatenate_columns(parts, RESIDUALS_SCHEMA)
    at = (
        c["measured"][:, :2]
        if unit == "px"
        else azimuth_elevation_deg(transform_residual_points(run, sensor, c))
    )
    cosine = c["cos_incidence"][c["cos_incidence"] > 0]
    incidence = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
    return ViewCoverage(at, c["range_m"], incidence, *collect_target_orientations(run, c))


def transform_residual_points(run, sensor, columns):
    """Measured points (n, 3), sensor frame, m, of a lidar's residuals."""
    out = np.zeros((len(columns["view"]), 3))
    for rows in group_rows_by_pair(columns["session"], columns["placement"]):
        session, placement = str(columns["session"][rows[0]]), int(columns["placement"][rows[0]])
        T = run.T_sensor_target(sensor, session, placement)
        T = T["solved"] if T["solved"] is not None else T["guess"]
        out[rows] = transform_points(T, columns["measured"][rows])
    return out


def azimuth_elevation_deg(p):
    """Azimuth and elevation (n, 2), deg, of points (n, 3)."""
    flat = np.hypot(p[:, 0], p[:, 1])
    return np.degrees(np.column_stack([np.arctan2(p[:, 1], p[:, 0]), np.arctan2(p[:, 2], flat)]))


def collect_target_orientations(run, columns):
    """Normals (k, 3) of flat targets and axes (m, 3) of the others, robot frame, by placement."""
    flat, axes = [], []
    for rows in group_rows_by_pair(columns["session"], columns["placement"]):
        session, placement = str(columns["session"][rows[0]]), int(columns["placement"][rows[0]])
        T = run.T_robot_target(session, placement)
        config = run.options["targets"][str(columns["target"][rows[0]])]
        if len(target_from_config(config).outline_edges()):
            flat.append(T[:3, 2])
        else:
            # An axis has no sign; half of the sphere holds all of them.
            axes.append(T[:3, 0] if T[0, 0] >= 0 else -T[:3, 0])
    return np.reshape(flat, (-1, 3)), np.reshape(axes, (-1, 3))


def max_pairwise_angle_deg(normals):
    """Largest angle, deg, between two directions (k, 3); None of fewer than two."""
    if len(normals) < 2:
        return None
    return float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1)).max()))


def tabulate_view_coverage(run, sensor, coverage):
    """What the table says of one sensor."""
    config, told = run.options["sensors"][sensor], run.sensors[sensor]
    counts = {k: format_count(told[k]) for k in ("placements", "observations")}
    if coverage is None:
        return {"name": sensor, "found": False} | counts
    wide = {
        "normals": max_pairwise_angle_deg(coverage.normals),
        "axes": max_pairwise_angle_deg(coverage.axes),
    }
    wide = [f"{what} {format_number(w, 2)}°" for what, w in wide.items() if w is not None]
    return counts | {
        "name": sensor,
        "found": True,
        "share": format_image_share(coverage, config)
        if config["kind"] == "camera"
        else format_azimuth_sectors(coverage),
        "range": format_value_range(coverage.range_m, "m"),
        "incidence": format_value_range(coverage.incidence_deg, "°"),
        "directions": ", ".join(wide) or DASH,
        "normals": format_count(len(coverage.normals)),
        "axes": format_count(len(coverage.axes)),
    }


def format_image_share(coverage, config):
    """`41 of 100 cells of the image` in which a camera measured."""
    size = np.asarray(config["size_px"])
    cells = np.clip(
        (coverage.view_coordinates + 0.5) * N_GRID_CELLS / size, 0, N_GRID_CELLS - 1
    ).astype(int)
    return f"{len(np.unique(cells, axis=0))} of {N_GRID_CELLS**2} cells of the image"


def format_azimuth_sectors(coverage):
    """`5 of 36 sectors of azimuth, elevation −12 to 9°` in which a lidar measured."""
    azimuth, elevation = coverage.view_coordinates.T
    n = len(np.unique(np.floor(azimuth / AZIMUTH_SECTOR_DEG)))
    return f"{n} of {360 // AZIMUTH_SECTOR_DEG} sectors of azimuth, elevation {format_value_range(elevation, '°')}"


def format_value_range(values, unit):
    """`1.4 to 3.2 m`, or a dash of nothing."""
    if not len(values):
        return DASH
    # A line never breaks between a number and its unit.
    space = "" if unit == "°" else "\u00a0"
    low, high = format_number(values.min(), 2), format_number(values.max(), 2)
    return f"{low} to {high}{space}{unit}"
