"""The verdict in three lines, its limits and what to do, as the template prints them."""

import numpy as np

from calib.geometry.units import MM_PER_M
from calib.report.number_format import DASH, format_number, format_percent, format_plural
from calib.verdict.findings import level_by_limits


def largest_pose_sigmas(sensor):
    """Largest σ of the position, m, and of the rotation, deg; None without a pose."""
    if sensor["covariance"] is None:
        return None, None
    sigma = np.sqrt(np.diag(sensor["covariance"]))
    return float(sigma[:3].max()), float(np.degrees(sigma[3:].max()))


def list_limit_checks(sensor):
    """Per limit: (heading, unit, key, factor to the unit, value, whether large is bad)."""
    position, rotation = largest_pose_sigmas(sensor)
    solved, held = position is not None, sensor["leave_one_out"]
    return (
        ("largest position σ", "mm", "sigma_m", MM_PER_M, position, True),
        ("largest rotation σ", "°", "sigma_deg", 1.0, rotation, True),
        ("rejected", "%", "rejected", 100.0, sensor["rejected_share"] if solved else None, True),
        ("placements", "", "placements", 1, sensor["placements"], False),
        (
            "cross-validation error",
            "σ",
            "leave_one_out",
            1.0,
            held["error_over_sigma"] if held else None,
            True,
        ),
    )


def _check_level(value, limits, key, is_upper_limit):
    """The judge's own level; a sensor without the value fails, but for placements left out, of
    which there may be none."""
    if value is None:
        return "pass" if key == "leave_one_out" else "fail"
    return level_by_limits(value, limits, key, is_upper_limit)


def _limit_share(value, limit, is_upper_limit):
    """How much of a limit a value takes up; None where either is missing or there is nothing."""
    if not value or not limit:
        return None
    return value / limit if is_upper_limit else limit / value


def _format_limits(limits, key, factor, is_upper_limit):
    """`warn above 5`, `fail above 20` of one pair of limits."""
    side = "above" if is_upper_limit else "below"
    found = [(lv, limits.get(f"{lv}_{key}")) for lv in ("warn", "fail")]
    return [f"{lv} {side} {format_number(v * factor)}" for lv, v in found if v is not None]


def summarize_verdict(run):
    """The verdict, its reasons, the limits, and every sensor's values against them."""
    judged = run.verdict
    limits, rows, heads = judged["limits"], [], []
    for name, sensor in run.sensors.items():
        cells, heads = [], []
        for heading, unit, key, factor, value, large in list_limit_checks(sensor):
            shown = DASH if value is None else format_number(value * factor)
            level = _check_level(value, limits, key, large)
            share = _limit_share(value, limits.get(f"warn_{key}"), large)
            cells.append({"text": shown, "level": level, "share": share})
            limit = _format_limits(limits, key, factor, large)
            heads.append({"text": heading, "unit": unit, "limit": limit})
        level = judged["sensors"].get(name, sensor["verdict"])
        row = {"name": name, "kind": sensor["kind"], "level": level, "cells": cells}
        rows.append(row | {"status": sensor["status"]})
    return {
        "level": judged["verdict"],
        "lines": [
            describe_calibrated_sensors(run),
            describe_main_reason(run, rows, heads),
            describe_next_action(judged),
        ],
        "reasons": judged["reasons"],
        "heads": heads,
        "rows": rows,
        "advice": list_remedies(judged["findings"]),
        "limits": {k: format_number(v) for k, v in sorted(limits.items())},
    }


def describe_calibrated_sensors(run):
    """First line: how many sensors have a pose, and which have none."""
    without = [n for n, s in run.sensors.items() if not s["T_robot_sensor"]]
    total = format_plural(len(run.sensors), "sensor")
    sessions = format_plural(len(run.sessions), "session")
    told = f"{len(run.sensors) - len(without)} of {total} calibrated from {sessions}"
    return f"{told}; no pose for {', '.join(without)}." if without else f"{told}."


def describe_main_reason(run, rows, heads):
    """Second line: the gravest reason, or how near to a limit the result comes."""
    reasons = run.verdict["reasons"]
    if reasons:
        more = len(reasons) - 1
        told = reasons[0] + _describe_missing_pose(run)
        return told + (f"; and {format_plural(more, 'more reason')}." if more else ".")
    near = [
        (cell["share"], row["name"], head["text"])
        for row in rows
        for cell, head in zip(row["cells"], heads, strict=True)
        if cell["share"] is not None
    ]
    if not near:
        return "Every sensor is within every limit."
    share, name, what = max(near)
    return (
        f"Every sensor is within every limit; nearest to one: {what} of {name}, "
        f"{format_percent(share)} of what would warn."
    )


def _describe_missing_pose(run):
    """What was found and expected of a sensor without a pose, if that is the gravest reason."""
    first = next(iter(run.verdict["findings"]), None)
    if not first or first["check"] != "status" or not first["sensor"]:
        return ""
    status = run.sensors[first["sensor"]]["status"]
    told = [f"{k} {status[k]}" for k in ("found", "expected") if status[k]]
    return f" ({'; '.join(told)})" if told else ""


def describe_next_action(verdict):
    """Third line: what to do about the gravest reason, or that the files can be used."""
    first = next((f for f in verdict["findings"] if f["remedy"]), None)
    if first:
        return (
            first["remedy"][0].upper()
            + first["remedy"][1:]
            + "." * (first["remedy"][-1] not in ".?")
        )
    return "Nothing is to be mended: load the files in export/, whose worked points say which way."


def list_remedies(findings):
    """[(level, who, what to do)] about everything that did not pass, each advice once."""
    who = {}
    for f in findings:
        if f["remedy"]:
            who.setdefault((f["level"], f["remedy"]), []).extend(f["sensors"])
    return [(level, ", ".join(dict.fromkeys(names)), what) for (level, what), names in who.items()]
