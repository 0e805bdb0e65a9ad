"""Residuals split by what they may depend on: how many, their mean and their rms, SI and σ."""

import numpy as np

from calib.io.parquet_tables import empty_columns, select_rows
from calib.io.table_schemas import RESIDUALS_SCHEMA
from calib.report.number_format import format_decimals, format_number
from calib.report.sections.residual_tables import (
    printed_unit,
    residual_components,
    residuals_by_kind,
    root_mean_square,
    select_inlier_rows,
    standardize_residuals,
)

MIN_GROUP_SIZE = 5  # groups of fewer are not told
N_BANDS = 6  # equal bins of range, incidence or speed
N_IMAGE_REGIONS = (3, 3)  # regions of an image, columns and rows
REGION_ROWS, REGION_COLUMNS = ("upper", "middle", "lower"), ("left", "middle", "right")
KINDS_WITH_RING = (
    "target_surface",
    "cylinder_cap",
    "template_point",
)  # kinds whose index is a ring


def tabulate_residual_splits(run, sensor):
    """Rows {kind, by, group, n, mean, rms, mean_sigma, rms_sigma} of one sensor's members."""
    out, in_motion = [], run.moving_residuals_by_sensor.get(sensor, {})
    for kind, columns in residuals_by_kind(run, sensor).items():
        used = select_inlier_rows(columns)
        moving = select_inlier_rows(in_motion.get(kind, empty_columns(RESIDUALS_SCHEMA)))
        if len(used["weight"]):
            config = run.options["sensors"][sensor]
            for by, group, rows in split_inliers(kind, used, config):
                out.append(_summarize_group(kind, by, group, select_rows(used, rows)))
            out += [
                _summarize_group(kind, "speed", g, part) for g, part in split_by_speed(used, moving)
            ]
    return [row for row in out if row]


def split_inliers(kind, columns, config):
    """[(by, group, rows)] of all groups of the members of one kind."""
    out = [("target", g, rows) for g, rows in _split_by_name(columns["target"])]
    out += [("session", g, rows) for g, rows in _split_by_name(columns["session"])]
    out += [("range", f"{g} m", rows) for g, rows in _split_into_bands(columns["range_m"])]
    seen = columns["cos_incidence"] > 0
    if seen.any():
        angle = np.degrees(np.arccos(np.clip(columns["cos_incidence"], 0, 1)))
        out += [("incidence", f"{g}°", rows) for g, rows in _split_into_bands(angle)]
    ring = columns["feature_index"]
    if kind in KINDS_WITH_RING and config["kind"] == "lidar":
        out += [("ring", f"{k}", ring == k) for k in np.unique(ring[ring >= 0]).tolist()]
    if config["kind"] == "camera":
        out += [
            ("image region", g, rows) for g, rows in _split_by_region(columns, config["size_px"])
        ]
    return out


def split_by_speed(still, moving):
    """[(group, columns)] of the members at rest, and of those in motion by their speed, m/s."""
    out = [("at rest", still)]
    if len(moving["weight"]):
        bands = _split_into_bands(moving["speed_mps"])
        out += [(f"{g} m/s", select_rows(moving, rows)) for g, rows in bands]
    return out


def _split_by_name(names):
    return [(str(n), names == n) for n in np.unique(names)]


def _split_into_bands(x):
    """[(`low to high`, rows)] of equal bins of x (n,), n > 0."""
    edges = np.linspace(x.min(), x.max(), N_BANDS + 1)
    at = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, N_BANDS - 1)
    named = [format_number(e, 2) for e in edges]
    return [(f"{named[k]} to {named[k + 1]}", at == k) for k in range(N_BANDS)]


def _split_by_region(columns, size):
    """[(`upper left`, rows)] of the parts of an image."""
    at = (columns["measured"][:, :2] + 0.5) * N_IMAGE_REGIONS / np.asarray(size)
    at = np.clip(at, 0, np.subtract(N_IMAGE_REGIONS, 1)).astype(int)
    return [
        (f"{row} {column}", (at[:, 0] == i) & (at[:, 1] == j))
        for j, row in enumerate(REGION_ROWS)
        for i, column in enumerate(REGION_COLUMNS)
    ]


def _summarize_group(kind, by, group, columns):
    """One row; None of too few."""
    n = len(columns["weight"])
    if n < MIN_GROUP_SIZE:
        return None
    unit, scale = printed_unit(kind)
    value, r = residual_components(columns) * scale, standardize_residuals(columns)
    mean = [format_number(v, 2) for v in value.mean(0)]
    return {
        "kind": kind,
        "by": by,
        "group": group,
        "n": n,
        "mean": f"({', '.join(mean)})" if len(mean) > 1 else mean[0],
        "rms": format_number(np.sqrt(np.mean(np.sum(value**2, 1)))),
        "unit": unit,
        "mean_sigma": format_decimals(np.linalg.norm(r.mean(0)) if len(mean) > 1 else r.mean(), 2),
        "rms_sigma": float(root_mean_square(r)),
    }
