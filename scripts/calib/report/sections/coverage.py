"""Coverage: which part of its view, which distances and inclinations a sensor measured."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.diagnosis.observability import largest_angle_deg, normals_and_axes
from calib.geometry.se3 import transform_points
from calib.io.parquet_tables import concatenate_columns
from calib.io.table_schemas import RESIDUALS_SCHEMA
from calib.report.data.run_data import Columns, ReportRun, shown_pose
from calib.report.number_format import DASH, format_count, format_number
from calib.report.sections.residuals import group_rows_by_pair, inliers_in_unit
from calib.targets.target_shapes import target_from_config

N_GRID_CELLS = 10  # cells per side of an image
AZIMUTH_SECTOR_DEG = 10  # of a lidar


@dataclass(frozen=True)
class ViewCoverage:
    """Inliers of one sensor, and the targets of its placements.

    view_coordinates (n, 2): px of a camera, azimuth and elevation, deg, of a lidar; range_m (n,);
    incidence_deg (k,): of inliers that have one; normals of boards and axes of other targets
    (k, 3): unit vectors in the robot frame, one per placement.
    """

    view_coordinates: np.ndarray
    range_m: np.ndarray
    incidence_deg: np.ndarray
    normals: np.ndarray
    axes: np.ndarray


def compute_view_coverage(run: ReportRun, sensor: str) -> ViewCoverage | None:
    """Compute the coverage of one sensor; None without an inlier."""
    is_camera = run.sensors[sensor]["kind"] == "camera"
    parts = inliers_in_unit(run, sensor, "px" if is_camera else "m")
    if not parts:
        return None
    inliers = concatenate_columns(parts, RESIDUALS_SCHEMA)
    if is_camera:
        view_coordinates = inliers["measured"][:, :2]
    else:
        view_coordinates = azimuth_elevation_deg(transform_residual_points(run, sensor, inliers))
    cosine = inliers["cos_incidence"][inliers["cos_incidence"] > 0]
    incidence_deg = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
    directions = collect_target_directions(run, inliers)
    return ViewCoverage(
        view_coordinates=view_coordinates,
        range_m=inliers["range_m"],
        incidence_deg=incidence_deg,
        normals=directions["normals"],
        axes=directions["axes"],
    )


def transform_residual_points(run: ReportRun, sensor: str, residuals: Columns) -> np.ndarray:
    """Return the measured points (n, 3), m, of the residuals of a lidar in its own frame."""
    points = np.zeros((len(residuals["view"]), 3))
    for rows in group_rows_by_pair(residuals["session"], residuals["placement"]):
        session = str(residuals["session"][rows[0]])
        poses = run.T_sensor_target(sensor, session, int(residuals["placement"][rows[0]]))
        points[rows] = transform_points(shown_pose(poses), residuals["measured"][rows])
    return points


def azimuth_elevation_deg(points: np.ndarray) -> np.ndarray:
    """Return azimuth and elevation (n, 2), deg, of points (n, 3)."""
    horizontal = np.hypot(points[:, 0], points[:, 1])
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    return np.degrees(np.column_stack([azimuth, np.arctan2(points[:, 2], horizontal)]))


def collect_target_directions(run: ReportRun, residuals: Columns) -> dict[str, np.ndarray]:
    """Return {"normals": (k, 3), "axes": (m, 3)} of boards and others, one per placement."""
    targets, T_robot_target = [], []
    for rows in group_rows_by_pair(residuals["session"], residuals["placement"]):
        session = str(residuals["session"][rows[0]])
        placement = int(residuals["placement"][rows[0]])
        config = run.options["targets"][str(residuals["target"][rows[0]])]
        targets.append(target_from_config(config))
        T_robot_target.append(run.T_robot_target(session, placement))
    directions = normals_and_axes(targets, np.array(T_robot_target))
    # An axis has no sign: all are turned into the same half of the sphere.
    axes = directions["axes"]
    return {"normals": directions["normals"], "axes": np.where(axes[:, :1] >= 0, axes, -axes)}


def tabulate_view_coverage(
    run: ReportRun, sensor: str, coverage: ViewCoverage | None
) -> dict[str, Any]:
    """Return the row of one sensor in the table of coverage."""
    block = run.sensors[sensor]
    row: dict[str, Any] = {k: format_count(block[k]) for k in ("placements", "observations")}
    row |= {"name": sensor, "has_inliers": coverage is not None}
    if coverage is None:
        return row
    angles = {
        "normals": largest_angle_deg(coverage.normals),
        "axes": largest_angle_deg(coverage.axes),
    }
    texts = [f"{what} {format_number(v, 2)}°" for what, v in angles.items() if v is not None]
    config = run.options["sensors"][sensor]
    is_camera = config["kind"] == "camera"
    return row | {
        "view_share": format_image_share(coverage, config["size_px"])
        if is_camera
        else format_azimuth_sectors(coverage),
        "range": format_value_range(coverage.range_m, "m"),
        "incidence": format_value_range(coverage.incidence_deg, "°"),
        "angles": ", ".join(texts) or DASH,
        "n_normals": format_count(len(coverage.normals)),
        "n_axes": format_count(len(coverage.axes)),
    }


def format_image_share(coverage: ViewCoverage, size_px: tuple[int, int]) -> str:
    """Format the part of the image with inliers of a camera: `41 of 100 cells of the image`."""
    cells = (coverage.view_coordinates + 0.5) * N_GRID_CELLS / np.asarray(size_px)
    cells = np.clip(cells, 0, N_GRID_CELLS - 1).astype(int)
    return f"{len(np.unique(cells, axis=0))} of {N_GRID_CELLS**2} cells of the image"


def format_azimuth_sectors(coverage: ViewCoverage) -> str:
    """Format the directions with inliers of a lidar: `5 of 36 sectors of azimuth, ...`."""
    azimuth, elevation = coverage.view_coordinates.T
    n = len(np.unique(np.floor(azimuth / AZIMUTH_SECTOR_DEG)))
    elevations = format_value_range(elevation, "°")
    return f"{n} of {360 // AZIMUTH_SECTOR_DEG} sectors of azimuth, elevation {elevations}"


def format_value_range(values: np.ndarray, unit: str) -> str:
    """Format the smallest and largest value: `1.4 to 3.2 m`; a dash without values."""
    if not len(values):
        return DASH
    # The space must not break between a number and its unit.
    space = "" if unit == "°" else "\u00a0"
    low, high = format_number(values.min(), 2), format_number(values.max(), 2)
    return f"{low} to {high}{space}{unit}"
