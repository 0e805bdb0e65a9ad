"""Verdict, unknowns beside the poses, convergence and provenance as the template prints them."""

import json

import numpy as np

from calib import verdict as judge
from calib.report import extrinsics, text
from calib.report.extrinsics import MM

AXES = [f"{what} {axis}" for what in ("the place along", "the turn about") for axis in "xyz"]
LOOSE = 0.9  # of the prior's σ: an alignment that is not better known than that stands as stated
CORRECTED = {  # what was estimated of a sensor besides, by name of the Hypothesis
    "apart": "returns and outlines",
    "beam_width": "width of the beams",
    "beams": "ranges of single beams",
    "range_bias": "ranges",
}


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
        ("placements left out", "σ", "heldout", 1.0, held["ratio"] if held else None, True),
    )


def _level(value, limits, key, large_is_bad):
    """The judge's own level; a sensor without the value fails, but for placements left out, of
    which there may be none."""
    if value is None:
        return "pass" if key == "heldout" else "fail"
    return judge.level(value, limits, key, large_is_bad)


def _limit(limits, key, factor, large_is_bad):
    """`warn above 5, fail above 20` of one pair of limits."""
    side = "above" if large_is_bad else "below"
    found = [(lv, limits.get(f"{lv}_{key}")) for lv in ("warn", "fail")]
    return ", ".join(f"{lv} {side} {text.number(v * factor)}" for lv, v in found if v is not None)


def verdict(run):
    """The verdict, its reasons, the limits, and every sensor's values against them."""
    judged = run.verdict
    limits, rows, heads = judged["limits"], [], []
    for name, sensor in run.sensors.items():
        cells, heads = [], []
        for heading, unit, key, factor, value, large in checks(sensor):
            shown = text.DASH if value is None else text.number(value * factor)
            cells.append({"text": shown, "level": _level(value, limits, key, large)})
            limit = _limit(limits, key, factor, large)
            heads.append({"text": heading, "unit": unit, "limit": limit})
        level = judged["sensors"].get(name, sensor["verdict"])
        row = {"name": name, "kind": sensor["kind"], "level": level, "cells": cells}
        rows.append(row | {"status": sensor["status"]})
    solved = [n for n, s in run.sensors.items() if s["T_robot_sensor"]]
    total = text.plural(len(run.sensors), "sensor")
    sessions = text.plural(len(run.sessions), "session")
    return {
        "level": judged["verdict"],
        "reasons": judged["reasons"],
        "heads": heads,
        "rows": rows,
        "advice": advice(judged["findings"]),
        "limits": {k: text.number(v) for k, v in sorted(limits.items())},
        "summary": f"{len(solved)} of {total} calibrated from {sessions}.",
    }


def advice(findings):
    """[(level, who, what to do)] about everything that did not pass, each advice once."""
    who = {}
    for f in findings:
        if f["remedy"]:
            who.setdefault((f["level"], f["remedy"]), []).extend(f["sensors"])
    return [(level, ", ".join(dict.fromkeys(names)), what) for (level, what), names in who.items()]


def other_unknowns(run):
    """(name, text or None) of everything beside the poses that could have been estimated."""
    rows = []
    for name, s in run.sensors.items():
        rows.append((f"time offset of {name}", _offset(s)))
        intrinsics = json.dumps(s["intrinsics"], sort_keys=True) if s["intrinsics"] else None
        rows += [(f"clock of {name} in {k}", _wander(w)) for k, w in _by_session(s)]
        if s["kind"] == "camera":
            rows.append((f"intrinsics of {name}", intrinsics))
        rows += [(f"{CORRECTED[c['name']]} of {name}", c["text"]) for c in s["corrections"]]
    for name, target in sorted(run.calibration["targets"].items()):
        rows.append((f"alignment of {name} in its MCS body", _alignment(target)))
    for name, session in sorted(run.calibration["sessions"].items()):
        if session:
            T = np.array(session["T_robot_markers"]["matrix"])
            rows.append((f"robot markers in {name}, in R", _pose(T, session["covariance"])))
    return rows


def _offset(sensor):
    """A sensor's offset with its σ and where it comes from, or why there is none."""
    offset, clock = sensor["time_offset_s"], sensor["clock"] or None
    if not offset:
        return clock
    value, sigma = offset["value"] * MM, offset["sigma"] * MM
    return f"{text.fixed(value, 3)} ± {text.number(sigma, 2)} ms, {clock}"


def _by_session(sensor):
    """[(session, offset and drift)] of a sensor whose clock wanders."""
    return sorted((sensor["time_wander"] or {}).items())


def _wander(found):
    """Offset in the middle of a session and drift within it, with their σ."""
    offset, drift = found["time_offset_s"], found["drift_ppm"]
    return (
        f"{text.fixed(offset['value'] * MM, 3)} ± {text.number(offset['sigma'] * MM, 2)} ms in its "
        f"middle, drift {text.number(drift['value'], 3)} ± {text.number(drift['sigma'], 2)} ppm"
    )


def _pose(T, covariance):
    """`x 1.2 ± 0.1 mm, ...` of a pose (4, 4)."""
    rows = extrinsics.rows(T, covariance, None, None)
    return ", ".join(f"{r['name']} {r['value']} ± {r['sigma']} {r['unit']}" for r in rows)


def _alignment(target):
    if not target:
        return None
    T = np.array(target["T_body_target"]["matrix"])
    told = _pose(T, target["covariance"])
    if target["prior"] is None:
        return told
    ratio = np.sqrt(np.diag(target["covariance"])) / target["prior"]
    loose = [AXES[i] for i in np.flatnonzero(ratio > LOOSE)]
    least = f"; σ is {text.number(ratio.min(), 2)} to {text.number(ratio.max(), 2)} of its prior"
    if not loose:
        return told + least
    return f"{told}{least}: nothing tells {', '.join(loose)} of the target; tilt it to more sides"


def convergence(run):
    """Rows of the rounds of solving and re-association."""
    it = run.iterations
    return [
        {
            "round": int(it["round"][i]),
            "cost": text.number(float(it["cost"][i]), 6),
            "ipopt": int(it["ipopt_iterations"][i]),
            "members": text.count(int(it["members"][i])),
            "changed": text.count(int(it["changed"][i])),
            "step_m": text.number(float(it["step_m"][i]) * MM, 2),
            "step_rad": text.number(float(np.degrees(it["step_rad"][i])), 2),
        }
        for i in range(len(it["round"]))
    ]


def provenance(run):
    """Versions, log fingerprints and the config that the stages were given."""
    known = run.calibration["provenance"]
    logs = {
        n: [line.split() for line in s.audit.get("fingerprint", [])]
        for n, s in run.sessions.items()
    }
    config = {k: run.options[k] for k in ("sensors", "targets")}
    return {
        "packages": sorted(known.get("packages", {}).items()),
        "other": {k: v for k, v in sorted(known.items()) if k not in ("packages", "sessions")},
        "schema_version": run.calibration["schema_version"],
        "logs": logs,
        "config": json.dumps(config, indent=1, sort_keys=True, ensure_ascii=False),
    }
