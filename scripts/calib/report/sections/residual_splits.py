"""Residuals split by what they may depend on: how many, their mean and their rms, SI and σ."""

import numpy as np

from calib.io import parquet_tables, table_schemas
from calib.report import number_format
from calib.report.sections import residual_tables

FEW = 5  # groups of fewer are not told
BANDS = 6  # equal bins of range, incidence or speed
IMAGE = (3, 3)  # regions of an image, columns and rows
ROWS, COLUMNS = ("upper", "middle", "lower"), ("left", "middle", "right")
RINGS = ("surface", "cap", "point")  # kinds whose index is a ring


def of_sensor(run, sensor):
    """Rows {kind, by, group, n, mean, rms, mean_sigma, rms_sigma} of one sensor's members."""
    out, in_motion = [], run.moving_by_sensor.get(sensor, {})
    for kind, columns in residual_tables.of(run, sensor).items():
        used = residual_tables.members(columns)
        moving = residual_tables.members(
            in_motion.get(kind, parquet_tables.empty(table_schemas.RESIDUALS))
        )
        if len(used["weight"]):
            config = run.options["sensors"][sensor]
            for by, group, rows in groups(kind, used, config):
                out.append(_row(kind, by, group, parquet_tables.select(used, rows)))
            out += [_row(kind, "speed", g, part) for g, part in by_speed(used, moving)]
    return [row for row in out if row]


def groups(kind, columns, config):
    """[(by, group, rows)] of all groups of the members of one kind."""
    out = [("target", g, rows) for g, rows in _named(columns["target"])]
    out += [("session", g, rows) for g, rows in _named(columns["session"])]
    out += [("range", f"{g} m", rows) for g, rows in _bands(columns["range"])]
    seen = columns["cosine"] > 0
    if seen.any():
        angle = np.degrees(np.arccos(np.clip(columns["cosine"], 0, 1)))
        out += [("incidence", f"{g}°", rows) for g, rows in _bands(angle)]
    ring = columns["index"]
    if kind in RINGS and config["kind"] == "lidar":
        out += [("ring", f"{k}", ring == k) for k in np.unique(ring[ring >= 0]).tolist()]
    if config["kind"] == "camera":
        out += [("image region", g, rows) for g, rows in _regions(columns, config["size_px"])]
    return out


def by_speed(still, moving):
    """[(group, columns)] of the members at rest, and of those in motion by their speed, m/s."""
    out = [("at rest", still)]
    if len(moving["weight"]):
        bands = _bands(moving["speed"])
        out += [(f"{g} m/s", parquet_tables.select(moving, rows)) for g, rows in bands]
    return out


def _named(names):
    return [(str(n), names == n) for n in np.unique(names)]


def _bands(x):
    """[(`low to high`, rows)] of equal bins of x (n,), n > 0."""
    edges = np.linspace(x.min(), x.max(), BANDS + 1)
    at = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BANDS - 1)
    named = [number_format.number(e, 2) for e in edges]
    return [(f"{named[k]} to {named[k + 1]}", at == k) for k in range(BANDS)]


def _regions(columns, size):
    """[(`upper left`, rows)] of the parts of an image."""
    at = (columns["measured"][:, :2] + 0.5) * IMAGE / np.asarray(size)
    at = np.clip(at, 0, np.subtract(IMAGE, 1)).astype(int)
    return [
        (f"{row} {column}", (at[:, 0] == i) & (at[:, 1] == j))
        for j, row in enumerate(ROWS)
        for i, column in enumerate(COLUMNS)
    ]


def _row(kind, by, group, columns):
    """One row; None of too few."""
    n = len(columns["weight"])
    if n < FEW:
        return None
    unit, scale = residual_tables.unit(kind)
    value, r = residual_tables.components(columns) * scale, residual_tables.normalised(columns)
    mean = [number_format.number(v, 2) for v in value.mean(0)]
    return {
        "kind": kind,
        "by": by,
        "group": group,
        "n": n,
        "mean": f"({', '.join(mean)})" if len(mean) > 1 else mean[0],
        "rms": number_format.number(np.sqrt(np.mean(np.sum(value**2, 1)))),
        "unit": unit,
        "mean_sigma": number_format.fixed(
            np.linalg.norm(r.mean(0)) if len(mean) > 1 else r.mean(), 2
        ),
        "rms_sigma": float(residual_tables.rms(r)),
    }
