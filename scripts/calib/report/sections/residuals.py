"""Residuals of residuals.parquet: inliers, rejected measurements and their statistics."""

import numpy as np

from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.io.parquet_tables import select_rows
from calib.report.data.run_data import Columns, ReportRun
from calib.report.number_format import (
    DASH,
    format_count,
    format_decimals,
    format_kind,
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
    "template_vertex": "distances of the measured corners of a board from their places",
}
PRINTED_UNITS = {"px": ("px", 1.0), "m": ("mm", MM_PER_M), "rad": ("°", DEG_PER_RAD)}


def printed_unit(kind: str) -> tuple[str, float]:
    """Return the printed unit of the residuals of a kind, and the factor to it from SI or px."""
    return PRINTED_UNITS[RESIDUAL_KINDS[kind].UNIT]


def residuals_by_kind(run: ReportRun, sensor: str) -> dict[str, Columns]:
    """Return the residuals of one sensor by kind."""
    return run.residuals_by_sensor.get(sensor, {})


def inliers_by_kind(run: ReportRun, sensor: str) -> dict[str, Columns]:
    """Return the inliers of one sensor by kind, without the kinds that have none."""
    inliers = {k: select_inlier_rows(c) for k, c in residuals_by_kind(run, sensor).items()}
    return {k: columns for k, columns in inliers.items() if len(columns["weight"])}


def inliers_in_unit(run: ReportRun, sensor: str, unit: str) -> list[Columns]:
    """Return the inliers of one sensor whose residuals are in a unit, one table per kind."""
    inliers = inliers_by_kind(run, sensor)
    return [columns for k, columns in inliers.items() if unit == RESIDUAL_KINDS[k].UNIT]


def select_main_lidar_residuals(columns_by_kind: dict[str, Columns]) -> Columns | None:
    """Return the residuals of the most frequent kind of length, m; None without one."""
    lengths = [c for k, c in columns_by_kind.items() if RESIDUAL_KINDS[k].UNIT == "m"]
    return max(lengths, key=lambda c: len(c["weight"]), default=None)


def select_inlier_rows(columns: Columns) -> Columns:
    """Return the rows that took part in the solve."""
    return select_rows(columns, np.asarray(columns["weight"]) > 0)


def residual_components(columns: Columns) -> np.ndarray:
    """Return residuals (n, 2) of pixels, or (n, 1) of distances and angles."""
    value = columns["value"]
    return value if np.any(value[:, 1] != 0) else value[:, :1]


def standardize_residuals(columns: Columns) -> np.ndarray:
    """Return residuals (n, 1 or 2) in units of their own σ."""
    return residual_components(columns) / columns["sigma"][:, None]


def root_mean_square(values: np.ndarray) -> float | None:
    """Return the root mean square, or None without values."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else None


def has_negative_residuals(residuals: np.ndarray) -> bool:
    """Return whether residuals can be negative. Lengths cannot, and are not normal."""
    return bool(np.any(np.asarray(residuals) < 0))


def count_tail_residuals(standardized: np.ndarray) -> tuple[int, float]:
    """Return how many standardized residuals exceed 3 σ, and how many of a normal would."""
    n_beyond = int(np.sum(np.abs(standardized) > TAIL_LIMIT_SIGMA))
    return n_beyond, NORMAL_TAIL_SHARE * np.size(standardized)


def tabulate_residual_kinds(run: ReportRun, sensor: str) -> list[dict[str, str]]:
    """Return one row per kind of measurement: how many, how large, how many beyond 3 σ."""
    rows = []
    for kind, columns in residuals_by_kind(run, sensor).items():
        inliers = select_inlier_rows(columns)
        n_inliers, n_measurements = len(inliers["weight"]), len(columns["weight"])
        unit, scale = printed_unit(kind)
        r = standardize_residuals(inliers) if n_inliers else np.zeros((0, 1))
        n_beyond, expected = count_tail_residuals(r)
        normal = f" (normal: {format_number(expected, 2)})"
        n_down_weighted = int(np.sum(inliers["weight"] < DOWN_WEIGHT_LIMIT))
        rms = f"{format_number(_vector_rms(inliers) * scale)} {unit}" if n_inliers else DASH
        rows.append(
            {
                "kind": format_kind(kind),
                "description": KIND_DESCRIPTIONS.get(kind, ""),
                "n_measurements": format_count(n_measurements),
                "n_inliers": format_count(n_inliers),
                "n_excluded": format_count(n_measurements - n_inliers),
                "n_down_weighted": format_count(n_down_weighted),
                "rms": rms,
                "rms_sigma": format_decimals(root_mean_square(r), 2),
                "n_beyond_3_sigma": format_count(n_beyond) + normal * has_negative_residuals(r),
            }
        )
    return rows


def _vector_rms(columns: Columns) -> float:
    return float(np.sqrt(np.mean(np.sum(residual_components(columns) ** 2, 1))))


def summarize_rejected(run: ReportRun, sensor: str) -> dict[str, str] | None:
    """Return how many candidates of one sensor lie outside the gate; None without a candidate."""
    block = run.calibration["sensors"][sensor]
    share, n_inliers = block["rejected_share"], block["points"]
    if share >= 1 or not n_inliers:
        return None
    n_candidates = round(n_inliers / (1 - share))
    return {
        "n_candidates": format_count(n_candidates),
        "n_rejected": format_count(n_candidates - n_inliers),
        "share": format_percent(share),
        "level": level_by_limits(share, run.verdict["limits"], "rejected"),
    }


def rms_by_placement(inliers: Columns) -> list[tuple[str, int, float]]:
    """Return (session, placement, rms in σ) of the inliers of each placement, in order."""
    r = standardize_residuals(inliers)
    scores = []
    for rows in group_rows_by_pair(inliers["session"], inliers["placement"]):
        session, placement = inliers["session"][rows[0]], inliers["placement"][rows[0]]
        scores.append((str(session), int(placement), root_mean_square(r[rows]) or 0.0))
    return scores


def group_rows_by_pair(first_key: np.ndarray, second_key: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each pair of values of two arrays (n,), n > 0, in order of the pairs."""
    order = np.lexsort((second_key, first_key))
    a, b = first_key[order], second_key[order]
    starts = np.flatnonzero((a[1:] != a[:-1]) | (b[1:] != b[:-1])) + 1
    return np.split(order, starts)


def score_views(
    columns_by_kind: dict[str, Columns],
) -> dict[tuple[str, int], tuple[int, float, int]]:
    """Return (placement, rms in σ, number of residuals) by session and view, over all kinds."""
    placements: dict[tuple[str, int], int] = {}
    parts: dict[tuple[str, int], list[np.ndarray]] = {}
    for columns in columns_by_kind.values():
        inliers = select_inlier_rows(columns)
        if not len(inliers["weight"]):
            continue
        r = standardize_residuals(inliers)
        for rows in group_rows_by_pair(inliers["session"], inliers["view"]):
            key = str(inliers["session"][rows[0]]), int(inliers["view"][rows[0]])
            placements.setdefault(key, int(inliers["placement"][rows[0]]))
            parts.setdefault(key, []).append(r[rows].ravel())
    scores = {}
    for key, arrays in sorted(parts.items()):
        values = np.concatenate(arrays)
        scores[key] = placements[key], root_mean_square(values) or 0.0, len(values)
    return scores


def tabulate_noise(run: ReportRun) -> list[dict[str, str]]:
    """Return one row per sensor and kind: configured σ, estimated σ and their ratio."""
    rows = []
    for sensor, kinds in sorted(run.calibration["noise"]["sensors"].items()):
        for kind, sigma in sorted(kinds.items()):
            unit, scale = printed_unit(kind)
            configured = median_keypoint_sigma(run, sensor, kind)
            ratio = None if configured is None else sigma / configured
            rows.append(
                {
                    "sensor": sensor,
                    "kind": format_kind(kind),
                    "configured_sigma": format_number(
                        None if configured is None else configured * scale
                    ),
                    "estimated_sigma": format_number(sigma * scale),
                    "ratio": format_number(ratio),
                    "unit": unit,
                }
            )
    return rows


def median_keypoint_sigma(run: ReportRun, sensor: str, kind: str) -> float | None:
    """Return the median σ of the keypoints of one kind, or None without any."""
    parts = []
    for session in run.sessions.values():
        if sensor in session.streams:
            keypoints = session.streams[sensor].keypoints
            is_kind = np.asarray(keypoints["kind"], str) == kind
            parts.append(np.asarray(keypoints["sigma"])[is_kind])
    sigma = np.concatenate(parts) if parts else np.zeros(0)
    return float(np.median(sigma)) if len(sigma) else None
