"""Every rig and session side by side: verdict, σ, drift since it was last accepted, repeatability.

calibration and verdict are calibration.json and verdict.json as they are.
"""

import numpy as np

from calib.geometry import se3
from calib.report import number_format
from calib.report.sections import extrinsics
from calib.report.sections.extrinsics import DEG, MM
from calib.verdict import findings

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
    told |= {"sigma_mm": number_format.DASH, "sigma_deg": number_format.DASH}
    told |= {"drift": drift(sensor, (last or {"sensors": {}})["sensors"].get(name))}
    told |= {"repeats": repeats(calibration, name), "reason": sensor["status"]["reason"]}
    if sensor["covariance"]:
        sigma = np.sqrt(np.diag(sensor["covariance"])).reshape(2, 3).max(1)
        told["sigma_mm"] = number_format.number(sigma[0] * MM, 2)
        told["sigma_deg"] = number_format.number(sigma[1] * DEG, 2)
    return told


def drift(now, then):
    """How far a pose lies from an earlier one: mm, deg, and that in what both σ expect; None
    without either."""
    if not then or not now["T_robot_sensor"] or not then["T_robot_sensor"]:
        return None
    T, T_then = (np.array(s["T_robot_sensor"]["matrix"]) for s in (now, then))
    mm, deg = extrinsics.distance(T, T_then)
    xi = se3.se3_log(se3.inverse(T_then) @ T)
    both = np.array(now["covariance"]) + np.array(then["covariance"])
    sigmas = float(np.sqrt(xi @ np.linalg.solve(both, xi) / 6))
    told = {"mm": number_format.number(mm, 2), "deg": number_format.number(deg, 2)}
    return told | {"sigmas": number_format.number(sigmas, 2), "far": sigmas > FAR}


def repeats(calibration, name):
    """How far sessions, each by itself, scatter about the others: rms, mm and deg; None of one."""
    shifts = [r["shift"] for r in calibration["repeatability"] if r["sensor"] == name]
    if not shifts:
        return None
    square = np.sum(np.reshape(shifts, (-1, 2, 3)) ** 2, axis=2)
    mm, deg = np.sqrt(square.mean(0)) * [MM, DEG]
    return {
        "mm": number_format.number(mm, 2),
        "deg": number_format.number(deg, 2),
        "sessions": len(shifts),
    }


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
