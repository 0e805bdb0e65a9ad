"""Verdict, extrinsics, noise, convergence and provenance as the template prints them."""

import itertools
import json

import numpy as np

from calib import geometry
from calib import verdict as judge
from calib.report import text

MM, DEG = 1e3, np.degrees(1.0)


def largest_sigmas(sensor):
    """Largest σ of the position, m, and of the rotation, deg; None without a pose."""
    if sensor["covariance"] is None:
        return None, None
    sigma = np.sqrt(np.diag(sensor["covariance"]))
    return float(sigma[:3].max()), float(np.degrees(sigma[3:].max()))


def checks(sensor):
    """Per limit: (heading, unit, key, factor to the unit, value, whether large is bad)."""
    position, rotation = largest_sigmas(sensor)
    solved = position is not None
    return (
        ("largest position σ", "mm", "sigma_m", MM, position, True),
        ("largest rotation σ", "°", "sigma_deg", 1.0, rotation, True),
        ("rejected", "%", "rejected", 100.0, sensor["rejected"] if solved else None, True),
        ("placements", "", "placements", 1, sensor["placements"], False),
    )


def _level(value, limits, key, large_is_bad):
    """The judge's own level; a sensor without the value fails."""
    return "fail" if value is None else judge.level(value, limits, key, large_is_bad)


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
        "limits": {k: text.number(v) for k, v in sorted(limits.items())},
        "summary": f"{len(solved)} of {total} calibrated from {sessions}.",
    }


def robot_axes(covariance, R):
    """Covariance (6, 6) with both blocks turned from the sensor's axes into the robot's."""
    turn = np.kron(np.eye(2), R)
    return turn @ np.asarray(covariance) @ turn.T


def _fixed(values, places):
    return [text.fixed(v, p) for v, p in zip(values, places, strict=True)]


def pose_rows(T, covariance):
    """Position, mm, and angles, deg, and their σ in the axes of both frames of T_a_b."""
    own = np.sqrt(np.diag(covariance))
    robot = np.sqrt(np.diag(robot_axes(covariance, T[:3, :3])))
    value = np.concatenate([T[:3, 3] * MM, geometry.to_rpy(T) * DEG])
    scale = np.repeat([MM, DEG], 3)
    places = [text.places(s) for s in np.repeat((robot * scale).reshape(2, 3).min(1), 3)]
    names = ("x", "mm"), ("y", "mm"), ("z", "mm"), ("roll", "°"), ("pitch", "°"), ("yaw", "°")
    columns = (_fixed(v, places) for v in (value, robot * scale, own * scale))
    return [
        {"name": n, "unit": u, "value": v, "robot": r, "own": o}
        for (n, u), v, r, o in zip(names, *columns, strict=True)
    ]


def extrinsic(name, sensor):
    """What is said of one sensor's pose."""
    out = {"name": name, "sensor": sensor, "solved": bool(sensor["T_robot_sensor"])}
    out |= {k: text.count(sensor[k]) for k in ("placements", "observations", "points")}
    out["rejected"] = text.percent(sensor["rejected"])
    out["residual"] = residual(**sensor["residual"])
    if not out["solved"]:
        return out
    T = np.array(sensor["T_robot_sensor"]["matrix"])
    out |= {"rows": pose_rows(T, sensor["covariance"]), "change": change(sensor["guess"], T)}
    out["worked"] = ", ".join(text.fixed(v, 4) for v in geometry.transform(T, [1.0, 0.0, 0.0]))
    out["quat"] = ", ".join(text.fixed(v, 8) for v in sensor["T_robot_sensor"]["quat_xyzw"])
    out["matrix"] = "\n".join(" ".join(f"{v: .9f}" for v in row) for row in T)
    weak = sensor.get("weakest")
    if weak:
        turning = weak["direction"].startswith("rotation")
        sigma = (
            f"{text.number(weak['sigma'] * (DEG if turning else MM), 2)} {'°' if turning else 'mm'}"
        )
        out["weakest"] = f"{weak['direction']}, σ {sigma}"
    return out


def residual(rms, unit):
    """A residual of calibration.json in mm or px."""
    if rms is None:
        return text.DASH
    return f"{text.number(rms * MM)} mm" if unit == "m" else f"{text.number(rms)} {unit}"


def change(guess, T):
    """How far the estimate lies from the first guess: mm, deg, and in σ of the guess."""
    if not guess.get("T_robot_sensor"):
        return None
    T_guess = np.array(guess["T_robot_sensor"]["matrix"])
    moved = geometry.inverse(T_guess) @ T
    shares = np.abs(geometry.se3_log(moved)) / np.array(guess["sigma"])
    return {
        "mm": text.number(np.linalg.norm(T[:3, 3] - T_guess[:3, 3]) * MM),
        "deg": text.number(np.degrees(geometry.angle(moved))),
        "sigmas": text.number(shares.max(), 2),
        "source": guess["source"],
    }


def extrinsics(run):
    """Every sensor's pose, or why it has none."""
    return [extrinsic(n, s) for n, s in run.sensors.items()]


def between(run):
    """Pose of every solved sensor in every earlier one, with σ from their joint covariance."""
    joint = run.calibration["joint_covariance"]
    rows = []
    for a, b in itertools.combinations(joint["order"] if joint else [], 2):
        at = [6 * joint["order"].index(n) + i for n in (a, b) for i in range(6)]
        T_r_a, T_r_b = run.T_robot_sensor(a), run.T_robot_sensor(b)
        block = np.array(joint["matrix"])[np.ix_(at, at)]
        covariance = geometry.covariance_of_relative(T_r_a, T_r_b, block)
        T = geometry.inverse(T_r_a) @ T_r_b
        rows.append({"a": a, "b": b, "rows": pose_rows(T, covariance)})
    return rows


def other_unknowns(run):
    """(name, text) of everything beside the poses that could have been estimated."""
    rows = []
    for name, s in run.sensors.items():
        offset = s["time_offset_s"]
        if offset:
            shown = (
                f"{text.fixed(offset['value'] * MM, 3)} ± {text.number(offset['sigma'] * MM, 2)} ms"
            )
        rows.append((f"time offset of {name}", shown if offset else "not estimated"))
        intrinsics = json.dumps(s["intrinsics"], sort_keys=True) if s["intrinsics"] else None
        if s["kind"] == "camera":
            rows.append((f"intrinsics of {name}", intrinsics or "not estimated"))
    for name, target in sorted(run.calibration["targets"].items()):
        rows.append((f"alignment of {name} in its MCS body", _alignment(target)))
    for name, session in sorted(run.calibration["sessions"].items()):
        if session:
            rows.append((f"robot markers in {name}", json.dumps(session, sort_keys=True)))
    return rows


def _alignment(target):
    if not target:
        return "not estimated"
    rows = pose_rows(np.array(target["T_body_target"]["matrix"]), target["covariance"])
    return ", ".join(f"{r['name']} {r['value']} ± {r['robot']} {r['unit']}" for r in rows)


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
