"""The verdict in three lines, its limits and what to do, as the template prints them."""

import numpy as np

from calib.report import number_format
from calib.report.sections.extrinsics import MM
from calib.verdict import findings as findings_module


def largest_sigmas(sensor):
    """Largest σ of the position, m, and of the rotation, deg; None without a pose."""
    if sensor["covariance"] is None:
        return None, None
    sigma = np.sqrt(np.diag(sensor["covariance"]))
    return float(sigma[:3].max()), float(np.degrees(sigma[3:].max()))


def checks(sensor):
    """Per limit: (heading, unit, key, factor to the unit, value, whether large is bad)."""
    position, rotation = largest_sigmas(sensor)
    solved, held = position is not None, sensor["held_out"]
    return (
        ("largest position σ", "mm", "sigma_m", MM, position, True),
        ("largest rotation σ", "°", "sigma_deg", 1.0, rotation, True),
        ("rejected", "%", "rejected", 100.0, sensor["rejected"] if solved else None, True),
        ("placements", "", "placements", 1, sensor["placements"], False),
        ("cross-validation error", "σ", "heldout", 1.0, held["ratio"] if held else None, True),
    )


def _level(value, limits, key, large_is_bad):
    """The judge's own level; a sensor without the value fails, but for placements left out, of
    which there may be none."""
    if value is None:
        return "pass" if key == "heldout" else "fail"
    return findings_module.level(value, limits, key, large_is_bad)


def _share(value, limit, large_is_bad):
    """How much of a limit a value takes up; None where either is missing or there is nothing."""
    if not value or not limit:
        return None
    return value / limit if large_is_bad else limit / value


def _limit(limits, key, factor, large_is_bad):
    """`warn above 5`, `fail above 20` of one pair of limits."""
    side = "above" if large_is_bad else "below"
    found = [(lv, limits.get(f"{lv}_{key}")) for lv in ("warn", "fail")]
    return [f"{lv} {side} {number_format.number(v * factor)}" for lv, v in found if v is not None]


def verdict(run):
    """The verdict, its reasons, the limits, and every sensor's values against them."""
    judged = run.verdict
    limits, rows, heads = judged["limits"], [], []
    for name, sensor in run.sensors.items():
        cells, heads = [], []
        for heading, unit, key, factor, value, large in checks(sensor):
            shown = number_format.DASH if value is None else number_format.number(value * factor)
            level = _level(value, limits, key, large)
            share = _share(value, limits.get(f"warn_{key}"), large)
            cells.append({"text": shown, "level": level, "share": share})
            limit = _limit(limits, key, factor, large)
            heads.append({"text": heading, "unit": unit, "limit": limit})
        level = judged["sensors"].get(name, sensor["verdict"])
        row = {"name": name, "kind": sensor["kind"], "level": level, "cells": cells}
        rows.append(row | {"status": sensor["status"]})
    return {
        "level": judged["verdict"],
        "lines": [found(run), why(run, rows, heads), todo(judged)],
        "reasons": judged["reasons"],
        "heads": heads,
        "rows": rows,
        "advice": advice(judged["findings"]),
        "limits": {k: number_format.number(v) for k, v in sorted(limits.items())},
    }


def found(run):
    """First line: how many sensors have a pose, and which have none."""
    without = [n for n, s in run.sensors.items() if not s["T_robot_sensor"]]
    total = number_format.plural(len(run.sensors), "sensor")
    sessions = number_format.plural(len(run.sessions), "session")
    told = f"{len(run.sensors) - len(without)} of {total} calibrated from {sessions}"
    return f"{told}; no pose for {', '.join(without)}." if without else f"{told}."


def why(run, rows, heads):
    """Second line: the gravest reason, or how near to a limit the result comes."""
    reasons = run.verdict["reasons"]
    if reasons:
        more = len(reasons) - 1
        told = reasons[0] + _instead(run)
        return told + (f"; and {number_format.plural(more, 'more reason')}." if more else ".")
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
        f"{number_format.percent(share)} of what would warn."
    )


def _instead(run):
    """What was found and expected of a sensor without a pose, if that is the gravest reason."""
    first = next(iter(run.verdict["findings"]), None)
    if not first or first["check"] != "status" or not first["sensor"]:
        return ""
    status = run.sensors[first["sensor"]]["status"]
    told = [f"{k} {status[k]}" for k in ("found", "expected") if status[k]]
    return f" ({'; '.join(told)})" if told else ""


def todo(judged):
    """Third line: what to do about the gravest reason, or that the files can be used."""
    first = next((f for f in judged["findings"] if f["remedy"]), None)
    if first:
        return (
            first["remedy"][0].upper()
            + first["remedy"][1:]
            + "." * (first["remedy"][-1] not in ".?")
        )
    return "Nothing is to be mended: load the files in export/, whose worked points say which way."


def advice(findings):
    """[(level, who, what to do)] about everything that did not pass, each advice once."""
    who = {}
    for f in findings:
        if f["remedy"]:
            who.setdefault((f["level"], f["remedy"]), []).extend(f["sensors"])
    return [(level, ", ".join(dict.fromkeys(names)), what) for (level, what), names in who.items()]
