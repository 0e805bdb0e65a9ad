"""The verdict in three lines, the values against the limits, and what to do."""

from typing import Any, NamedTuple

import numpy as np

from calib.geometry.units import DEG_PER_RAD, MM_PER_M, SHARE_TO_PERCENT
from calib.report.data.run_data import ReportRun
from calib.report.number_format import DASH, format_number, format_percent, format_plural
from calib.verdict.findings import level_by_limits


class LimitCell(NamedTuple):
    """One value of a sensor against its limits warn_<key> and fail_<key>.

    factor: from the value to the printed unit; is_upper_limit: whether large values are bad.
    """

    heading: str
    unit: str
    key: str
    factor: float
    value: float | None
    is_upper_limit: bool


def largest_pose_sigmas(sensor: dict[str, Any]) -> tuple[float | None, float | None]:
    """Return the largest σ of the position, m, and of the rotation, deg; None without a pose."""
    if sensor["covariance"] is None:
        return None, None
    sigma = np.sqrt(np.diag(sensor["covariance"]))
    return float(sigma[:3].max()), float(sigma[3:].max() * DEG_PER_RAD)


def list_limit_cells(sensor: dict[str, Any]) -> tuple[LimitCell, ...]:
    """Return the values of one sensor that the verdict compares with limits."""
    position, rotation = largest_pose_sigmas(sensor)
    rejected = sensor["rejected_share"] if position is not None else None
    leave_one_out = sensor["leave_one_out"]
    ratio = leave_one_out["error_over_sigma"] if leave_one_out else None
    return (
        LimitCell("largest position σ", "mm", "sigma_m", MM_PER_M, position, True),
        LimitCell("largest rotation σ", "°", "sigma_deg", 1.0, rotation, True),
        LimitCell("rejected", "%", "rejected", SHARE_TO_PERCENT, rejected, True),
        LimitCell("placements", "", "placements", 1.0, sensor["placements"], False),
        LimitCell("leave-one-out error", "σ", "leave_one_out", 1.0, ratio, True),
    )


def _check_level(cell: LimitCell, limits: dict[str, float]) -> str:
    """Return the level of a value. A missing value fails, except for leave-one-out."""
    if cell.value is None:
        return "pass" if cell.key == "leave_one_out" else "fail"
    return level_by_limits(cell.value, limits, cell.key, cell.is_upper_limit)


def _limit_share(cell: LimitCell, limits: dict[str, float]) -> float | None:
    """Return the value as a share of its warn limit; None if either is missing or zero."""
    limit = limits.get(f"warn_{cell.key}")
    if not cell.value or not limit:
        return None
    return cell.value / limit if cell.is_upper_limit else limit / cell.value


def _format_limits(cell: LimitCell, limits: dict[str, float]) -> list[str]:
    """Format the limits of a value: `warn above 5`, `fail above 20`."""
    side = "above" if cell.is_upper_limit else "below"
    return [
        f"{level} {side} {format_number(limit * cell.factor)}"
        for level in ("warn", "fail")
        if (limit := limits.get(f"{level}_{cell.key}")) is not None
    ]


def summarize_verdict(run: ReportRun) -> dict[str, Any]:
    """Return the verdict, its reasons, the limits, and the values of all sensors against them."""
    verdict = run.verdict
    limits, rows, columns = verdict["limits"], [], []
    for name, sensor in run.sensors.items():
        limit_cells = list_limit_cells(sensor)
        columns = [
            {"text": c.heading, "unit": c.unit, "limit_texts": _format_limits(c, limits)}
            for c in limit_cells
        ]
        cells = [
            {
                "text": DASH if c.value is None else format_number(c.value * c.factor),
                "level": _check_level(c, limits),
                "limit_share": _limit_share(c, limits),
            }
            for c in limit_cells
        ]
        level = verdict["sensors"].get(name, sensor["verdict"])
        rows.append({"name": name, "kind": sensor["kind"], "level": level, "cells": cells})
    return {
        "level": verdict["verdict"],
        "lines": [
            describe_calibrated_sensors(run),
            describe_main_reason(run, rows, columns),
            describe_next_action(verdict["findings"]),
        ],
        "columns": columns,
        "rows": rows,
        "advice": list_advice(verdict["findings"]),
        "limits": {k: format_number(v) for k, v in sorted(limits.items())},
    }


def describe_calibrated_sensors(run: ReportRun) -> str:
    """Return the first line: how many sensors have a pose, and which have none."""
    without = [n for n, s in run.sensors.items() if not s["T_robot_sensor"]]
    n_calibrated = len(run.sensors) - len(without)
    sensors = format_plural(len(run.sensors), "sensor")
    sessions = format_plural(len(run.sessions), "session")
    text = f"{n_calibrated} of {sensors} calibrated from {sessions}"
    return f"{text}; no pose for {', '.join(without)}." if without else f"{text}."


def describe_main_reason(
    run: ReportRun, rows: list[dict[str, Any]], columns: list[dict[str, Any]]
) -> str:
    """Return the second line: the most important reason, or the value nearest to its limit."""
    reasons = run.verdict["reasons"]
    if reasons:
        more = format_plural(len(reasons) - 1, "more reason")
        text = reasons[0] + _describe_missing_pose(run)
        return f"{text}; and {more}." if len(reasons) > 1 else f"{text}."
    shares = [
        (cell["limit_share"], row["name"], column["text"])
        for row in rows
        for cell, column in zip(row["cells"], columns, strict=True)
        if cell["limit_share"] is not None
    ]
    if not shares:
        return "All sensors are within all limits."
    share, name, what = max(shares)
    return (
        f"All sensors are within all limits. Nearest to its limit: {what} of {name}, at "
        f"{format_percent(share)} of the warn limit."
    )


def _describe_missing_pose(run: ReportRun) -> str:
    """Return ` (found ...; expected ...)` if the first finding is a sensor without a pose."""
    first = next(iter(run.verdict["findings"]), None)
    if not first or first["check"] != "status" or not first["sensor"]:
        return ""
    status = run.sensors[first["sensor"]]["status"]
    parts = [f"{k} {status[k]}" for k in ("found", "expected") if status[k]]
    return f" ({'; '.join(parts)})" if parts else ""


def describe_next_action(findings: list[dict[str, Any]]) -> str:
    """Return the third line: the first remedy, or that the exported files can be used."""
    remedy = next((f["remedy"] for f in findings if f["remedy"]), None)
    if remedy is None:
        return (
            "Nothing. Load the files in export/. The example points in export/README.md show the "
            "direction of each transform."
        )
    return remedy[0].upper() + remedy[1:] + ("" if remedy[-1] in ".?" else ".")


def list_advice(findings: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return {level, reasons, remedy} of all findings in order, each remedy once per level."""
    out: dict[tuple[str, str], list[str]] = {}
    for f in findings:
        out.setdefault((f["level"], f["remedy"]), []).append(f["text"])
    return [
        {"level": level, "reasons": reasons, "remedy": remedy}
        for (level, remedy), reasons in out.items()
    ]
