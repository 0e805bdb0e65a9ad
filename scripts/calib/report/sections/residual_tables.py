"""Members, rejected measurements and their statistics, from residuals.parquet."""

import numpy as np

from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.io.parquet_tables import select_rows
from calib.report.number_format import (
    DASH,
    format_count,
    format_decimals,
    format_number,
    format_percent,
)
from calib.verdict.findings import level_by_limits

TAIL_LIMIT_SIGMA = 3.0
NORMAL_TAIL_SHARE = 0.0026998  # share of N(0, 1) beyond 3 σ
DOWN_WEIGHT_LIMIT = 0.5
KIND_DESCRIPTIONS = {
    "cylinder_cap": "distances of returns from a flat end of the cylinder",
    "pattern_corner": "pattern corners, u and v",
    "board_outline": "angles between outline crossings and the outline",
    "cylinder_limb": "distances of contour points from the cylinder’s limb",
    "template_point": "distances of returns from the nearest template points",
    "template_silhouette": "distances of contour points from the template’s outline",
    "target_surface": "distances of returns from the surface",
    "template_vertex": "distances of a board’s corners from where they should be",
}
PRINTED_UNITS = {"px": ("px", 1.0), "m": ("mm", 1e3), "rad": ("°", np.degrees(1.0))}


def printed_unit(kind):
    """(unit, factor from SI or px) in which residuals of a kind are printed."""
    return PRINTED_UNITS[RESIDUAL_KINDS[kind].UNIT]


def select_main_lidar_residuals(kinds):
    """Columns of the kind of length, m, of {kind: columns} that counts the most; None without."""
    found = [c for k, c in kinds.items() if RESIDUAL_KINDS[k].UNIT == "m"]
    return max(found, key=lambda c: len(c["weight"]), default=None)


def residuals_by_kind(run, sensor):
    """{kind: columns} of one sensor."""
    return run.residuals_by_sensor.get(sensor, {})


def select_inlier_rows(columns):
    """The rows that took part in the solve."""
    return select_rows(columns, np.asarray(columns["weight"]) > 0)


def residual_components(columns):
    """(n, 1 or 2) residuals: pixels have two components, distances and angles one."""
    value = columns["value"]
    return value if np.any(value[:, 1] != 0) else value[:, :1]


def standardize_residuals(columns):
    """(n, 1 or 2) residuals in units of their own σ."""
    return residual_components(columns) / columns["sigma"][:, None]


def root_mean_square(values):
    """Root mean square, or None of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else None


def has_negative_residuals(r):
    """Whether residuals can be negative; lengths cannot, and follow no normal."""
    return bool(np.any(np.asarray(r) < 0))


def count_tail_residuals(r):
    """How many of the normalised residuals lie beyond 3 σ, and how many of a normal would."""
    return int(np.sum(np.abs(r) > TAIL_LIMIT_SIGMA)), NORMAL_TAIL_SHARE * np.size(r)


def tabulate_residual_kinds(run, sensor):
    """One row per kind of measurement: how many, how large, how many beyond 3 σ or left out."""
    rows = []
    for kind, columns in residuals_by_kind(run, sensor).items():
        used = select_inlier_rows(columns)
        n, all_rows = len(used["weight"]), len(columns["weight"])
        name, scale = printed_unit(kind)
        r = standardize_residuals(used) if n else np.zeros((0, 1))
        out, expected = count_tail_residuals(r)
        told = f" (normal: {format_number(expected, 2)})"
        rows.append(
            {
                "kind": kind,
                "meaning": KIND_DESCRIPTIONS.get(kind, ""),
                "handed": format_count(all_rows),
                "used": format_count(n),
                "left_out": format_count(all_rows - n),
                "down": format_count(int(np.sum(used["weight"] < DOWN_WEIGHT_LIMIT))),
                "rms": f"{format_number(_vector_rms(used) * scale)} {name}" if n else DASH,
                "rms_sigma": format_decimals(root_mean_square(r), 2),
                "beyond": format_count(out) + told * has_negative_residuals(r),
            }
        )
    return rows


def summarize_rejected(run, sensor):
    """(candidates, rejected, share, level) of one sensor: what geometry admits, the gate refused.

    None without a candidate.
    """
    found = run.calibration["sensors"][sensor]
    share, members_ = found["rejected_share"], found["points"]
    if share >= 1 or not members_:
        return None
    candidates = round(members_ / (1 - share))
    level = level_by_limits(share, run.verdict["limits"], "rejected")
    n = candidates - members_
    return {
        "of": format_count(candidates),
        "n": format_count(n),
        "share": format_percent(share),
    } | {"level": level}


def _vector_rms(columns):
    return float(np.sqrt(np.mean(np.sum(residual_components(columns) ** 2, 1))))


def rms_by_placement(columns):
    """[(session, placement, members, rms in σ)] in order; columns hold members."""
    r = standardize_residuals(columns)
    out = []
    for rows in group_rows_by_pair(columns["session"], columns["placement"]):
        key = str(columns["session"][rows[0]]), int(columns["placement"][rows[0]])
        out.append((*key, len(rows), root_mean_square(r[rows])))
    return out


def group_rows_by_pair(first_key, second_key):
    """Rows of each pair of values of two arrays (n,), n > 0, in order of the pairs."""
    order = np.lexsort((second_key, first_key))
    a, b = first_key[order], second_key[order]
    starts = np.flatnonzero((a[1:] != a[:-1]) | (b[1:] != b[:-1])) + 1
    return np.split(order, starts)


def score_views(columns_by_kind):
    """{(session, view): (placement, rms in σ, members)} over all kinds of one sensor."""
    gathered = {}
    for columns in columns_by_kind.values():
        used = select_inlier_rows(columns)
        if not len(used["weight"]):
            continue
        r = standardize_residuals(used)
        for rows in group_rows_by_pair(used["session"], used["view"]):
            at = str(used["session"][rows[0]]), int(used["view"][rows[0]])
            gathered.setdefault(at, (int(used["placement"][rows[0]]), []))[1].append(
                r[rows].ravel()
            )
    parts = {k: (p, np.concatenate(v)) for k, (p, v) in gathered.items()}
    return {k: (p, root_mean_square(v), len(v)) for k, (p, v) in sorted(parts.items())}


def tabulate_noise(run):
    """Rows of configured against re-estimated σ by sensor and kind."""
    rows = []
    for sensor, kinds in sorted(run.calibration["noise"]["sensors"].items()):
        for kind, sigma in sorted(kinds.items()):
            name, scale = printed_unit(kind)
            given = median_keypoint_sigma(run, sensor, kind)
            rows.append(
                {
                    "sensor": sensor,
                    "kind": kind,
                    "configured": format_number(None if given is None else given * scale),
                    "found": format_number(sigma * scale),
                    "ratio": format_number(None if given is None else sigma / given),
                    "unit": name,
                }
            )
    return rows


def median_keypoint_sigma(run, sensor, kind):
    """Median σ that the keypoints of one kind came with, or None without any."""
    parts = []
    for session in run.sessions.values():
        if sensor in session.streams:
            k = session.streams[sensor].keypoints
            parts.append(np.asarray(k["sigma"])[np.asarray(k["kind"], str) == kind])
    sigma = np.concatenate(parts) if parts else np.zeros(0)
    return float(np.median(sigma)) if len(sigma) else None
