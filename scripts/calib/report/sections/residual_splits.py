"""Residuals split by what they may depend on: counts, mean and rms, in SI units and in σ."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from calib.io.parquet_tables import empty_columns, select_rows
from calib.io.table_schemas import RESIDUALS_SCHEMA
from calib.report.data.run_data import Columns, ReportRun
from calib.report.number_format import format_decimals, format_kind, format_number
from calib.report.sections.residuals import (
    inliers_by_kind,
    printed_unit,
    residual_components,
    root_mean_square,
    select_inlier_rows,
    standardize_residuals,
)

MIN_GROUP_SIZE = 5  # smaller groups are not shown
N_BANDS = 6  # equal bins of range, incidence or speed
N_IMAGE_REGIONS = (3, 3)  # columns and rows
REGION_ROWS, REGION_COLUMNS = ("upper", "middle", "lower"), ("left", "middle", "right")
# Kinds whose feature index is the ring of a lidar.
KINDS_WITH_RING = ("target_surface", "cylinder_cap", "template_point")


def tabulate_residual_splits(run: ReportRun, sensor: str) -> list[dict[str, Any]]:
    """Return one row per group of the inliers of one sensor, groups of too few left out."""
    rows = []
    moving_by_kind = run.moving_residuals_by_sensor.get(sensor, {})
    for kind, inliers in inliers_by_kind(run, sensor).items():
        moving = select_inlier_rows(moving_by_kind.get(kind, empty_columns(RESIDUALS_SCHEMA)))
        for by, group, columns in (
            *split_inliers(kind, inliers, run.options["sensors"][sensor]),
            *split_by_speed(inliers, moving),
        ):
            if len(columns["weight"]) >= MIN_GROUP_SIZE:
                rows.append({"by": by, "group": group} | _summarize_group(kind, columns))
    return rows


def split_inliers(
    kind: str, inliers: Columns, config: dict[str, Any]
) -> Iterator[tuple[str, str, Columns]]:
    """Yield (quantity, group, inliers of the group) of one kind; config: of the sensor."""
    masks = [("target", g, rows) for g, rows in _split_by_name(inliers["target"])]
    masks += [("session", g, rows) for g, rows in _split_by_name(inliers["session"])]
    masks += [("range", f"{g} m", rows) for g, rows in _split_into_bands(inliers["range_m"])]
    if (inliers["cos_incidence"] > 0).any():
        angle = np.degrees(np.arccos(np.clip(inliers["cos_incidence"], 0, 1)))
        masks += [("incidence", f"{g}°", rows) for g, rows in _split_into_bands(angle)]
    ring = inliers["feature_index"]
    if kind in KINDS_WITH_RING and config["kind"] == "lidar":
        masks += [("ring", f"{k}", ring == k) for k in np.unique(ring[ring >= 0]).tolist()]
    if config["kind"] == "camera":
        regions = _split_by_region(inliers["measured"], config["size_px"])
        masks += [("image region", g, rows) for g, rows in regions]
    for by, group, rows in masks:
        yield by, group, select_rows(inliers, rows)


def split_by_speed(still: Columns, moving: Columns) -> Iterator[tuple[str, str, Columns]]:
    """Yield ("speed", group, inliers): those of still targets, then the others by speed, m/s."""
    yield "speed", "at rest", still
    if len(moving["weight"]):
        for group, rows in _split_into_bands(moving["speed_mps"]):
            yield "speed", f"{group} m/s", select_rows(moving, rows)


def _split_by_name(names: np.ndarray) -> list[tuple[str, np.ndarray]]:
    return [(str(n), names == n) for n in np.unique(names)]


def _split_into_bands(x: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return (`low to high`, mask (n,)) of N_BANDS equal bins of x (n,), n > 0."""
    edges = np.linspace(x.min(), x.max(), N_BANDS + 1)
    band = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, N_BANDS - 1)
    texts = [format_number(e, 2) for e in edges]
    return [(f"{texts[k]} to {texts[k + 1]}", band == k) for k in range(N_BANDS)]


def _split_by_region(pixels: np.ndarray, size_px: tuple[int, int]) -> list[tuple[str, np.ndarray]]:
    """Return (`upper left`, mask (n,)) of the parts of an image; pixels: (n, 2 or more)."""
    cell = (pixels[:, :2] + 0.5) * N_IMAGE_REGIONS / np.asarray(size_px)
    cell = np.clip(cell, 0, np.subtract(N_IMAGE_REGIONS, 1)).astype(int)
    return [
        (f"{row} {column}", (cell[:, 0] == i) & (cell[:, 1] == j))
        for j, row in enumerate(REGION_ROWS)
        for i, column in enumerate(REGION_COLUMNS)
    ]


def _summarize_group(kind: str, inliers: Columns) -> dict[str, Any]:
    """Return count, mean and rms of one group; the mean of pixels has two components."""
    unit, scale = printed_unit(kind)
    value, r = residual_components(inliers) * scale, standardize_residuals(inliers)
    mean = [format_number(v, 2) for v in value.mean(0)]
    is_plane = len(mean) > 1
    mean_sigma = np.linalg.norm(r.mean(0)) if is_plane else r.mean()
    return {
        "kind": format_kind(kind),
        "n": len(inliers["weight"]),
        "mean": f"({', '.join(mean)})" if is_plane else mean[0],
        "rms": format_number(np.sqrt(np.mean(np.sum(value**2, 1)))),
        "unit": unit,
        "mean_sigma": format_decimals(float(mean_sigma), 2),
        "rms_sigma": root_mean_square(r),
    }
