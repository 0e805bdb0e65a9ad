"""Every rig and session side by side: verdict, σ, drift since it was last accepted, repeatability.

calibration and verdict are calibration.json and verdict.json as they are.
"""

import numpy as np

from calib import findings, geometry
from calib.report import extrinsics, text
from calib.report.extrinsics import DEG, MM

FAR = 3.0  # σ: a drift beyond that is marked


def of_rig(calibration, verdict, earlier, audits):
    """What is told of one rig; earlier: [(name, calibration)] accepted before it, the oldest
    first; audits: log.json by session, None where there is none."""
    last = earlier[-1] if earlier else None
    return {
        "level": verdict["verdict"],
        "reason": verdict["reasons"][0] if verdict["reasons"] else "Every limit is kept.",
        "more": max(len(verdict["reasons"]) - 1, 0),
        "accepted": len(earlier),
        "last": last[0] if last else None,
        "sensors": [
            of_sensor(calibration, verdict, name, last[1] if last else None)
            for name in sorted(calibration["sensors"])
        ],
        "sessions": [of_session(calibration, verdict, n, a) for n, a in sorted(audits.items())],
    }


def of_sensor(calibration, verdict, name, last):
    """One sensor's verdict, the largest σ of its pose, its drift and its repeatability."""
    sensor = calibration["sensors"][name]
    told = {"name": name, "kind": sensor["kind"], "level": verdict["sensors"][name]}
    told |= {"sigma_mm": text.DASH, "sigma_deg": text.DASH}
    told |= {"drift": drift(sensor, (last or {"sensors": {}})["sensors"].get(name))}
    told |= {"repeats": repeats(calibration, name), "reason": sensor["status"]["reason"]}
    if sensor["covariance"]:
        sigma = np.sqrt(np.diag(sensor["covariance"])).reshape(2, 3).max(1)
        told["sigma_mm"] = text.number(sigma[0] * MM, 2)
        told["sigma_deg"] = text.number(sigma[1] * DEG, 2)
    return told


def drift(now, then):
    """How far a pose lies from an earlier one: mm, deg, and that in what both σ expect; None
    without either."""
    if not then or not now["T_robot_sensor"] or not then["T_robot_sensor"]:
        return None
    T, T_then = (np.array(s["T_robot_sensor"]["matrix"]) for s in (now, then))
    mm, deg = extrinsics.distance(T, T_then)
    xi = geometry.se3_log(geometry.inverse(T_then) @ T)
    both = np.array(now["covariance"]) + np.array(then["covariance"])
    sigmas = float(np.sqrt(xi @ np.linalg.solve(both, xi) / 6))
    told = {"mm": text.number(mm, 2), "deg": text.number(deg, 2)}
    return told | {"sigmas": text.number(sigmas, 2), "far": sigmas > FAR}


def repeats(calibration, name):
    """How far sessions, each by itself, scatter about the others: rms, mm and deg; None of one."""
    shifts = [r["shift"] for r in calibration["repeatability"] if r["sensor"] == name]
    if not shifts:
        return None
    square = np.sum(np.reshape(shifts, (-1, 2, 3)) ** 2, axis=2)
    mm, deg = np.sqrt(square.mean(0)) * [MM, DEG]
    return {"mm": text.number(mm, 2), "deg": text.number(deg, 2), "sessions": len(shifts)}


def of_session(calibration, verdict, name, audit):
    """One session's verdict: what its recording lacks, and which sensors sit elsewhere in it."""
    if audit is None:
        return {"name": name, "level": "fail", "told": "not decoded"}
    faults = [s["status"]["reason"] for part in ("sensors", "bodies") for s in audit[part].values()]
    faults = list(dict.fromkeys(f for f in faults if f))
    moved = [f for f in verdict["findings"] if f["check"] == "moved" and f" {name} " in f["text"]]
    levels = ["fail"] * bool(faults) + [f["level"] for f in moved]
    told = faults + [f["text"] for f in moved]
    return {"name": name, "level": findings.worst(levels), "told": "; ".join(told) or "complete"}
