"""Every rig and session side by side: verdict, σ, drift since it was last accepted, repeatability.

calibration and verdict are calibration.json and verdict.json as they are.
"""

import numpy as np

from calib.geometry.se3 import invert_pose, se3_log
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.number_format import DASH, format_number
from calib.report.sections.extrinsics import pose_distance_mm_deg
from calib.verdict.findings import worst_level

DRIFT_LIMIT_SIGMA = 3.0  # σ: a drift beyond that is marked


def build_rig_overview(calibration, verdict, accepted_calibrations, audits):
    """What is told of one rig; accepted_calibrations: [(name, calibration)] accepted before it, the oldest
    first; audits: log.json by session, None where there is none."""
    last = accepted_calibrations[-1] if accepted_calibrations else None
    return {
        "level": verdict["verdict"],
        "reason": verdict["reasons"][0] if verdict["reasons"] else "Every limit is kept.",
        "more": max(len(verdict["reasons"]) - 1, 0),
        "accepted": len(accepted_calibrations),
        "last": last[0] if last else None,
        "sensors": [
            build_sensor_overview(calibration, verdict, name, last[1] if last else None)
            for name in sorted(calibration["sensors"])
        ],
        "sessions": [
            build_session_overview(calibration, verdict, n, a) for n, a in sorted(audits.items())
        ],
    }


def build_sensor_overview(calibration, verdict, name, accepted_calibration):
    """One sensor's verdict, the largest σ of its pose, its drift and its repeatability."""
    sensor = calibration["sensors"][name]
    told = {"name": name, "kind": sensor["kind"], "level": verdict["sensors"][name]}
    told |= {"sigma_mm": DASH, "sigma_deg": DASH}
    told |= {
        "drift": format_pose_drift(
            sensor, (accepted_calibration or {"sensors": {}})["sensors"].get(name)
        )
    }
    told |= {
        "repeats": format_repeatability(calibration, name),
        "reason": sensor["status"]["reason"],
    }
    if sensor["covariance"]:
        sigma = np.sqrt(np.diag(sensor["covariance"])).reshape(2, 3).max(1)
        told["sigma_mm"] = format_number(sigma[0] * MM_PER_M, 2)
        told["sigma_deg"] = format_number(sigma[1] * DEG_PER_RAD, 2)
    return told


def format_pose_drift(sensor, accepted_sensor):
    """How far a pose lies from an earlier one: mm, deg, and that in what both σ expect; None
    without either."""
    if not accepted_sensor or not sensor["T_robot_sensor"] or not accepted_sensor["T_robot_sensor"]:
        return None
    T, T_then = (np.array(s["T_robot_sensor"]["matrix"]) for s in (sensor, accepted_sensor))
    mm, deg = pose_distance_mm_deg(T, T_then)
    xi = se3_log(invert_pose(T_then) @ T)
    both = np.array(sensor["covariance"]) + np.array(accepted_sensor["covariance"])
    sigmas = float(np.sqrt(xi @ np.linalg.solve(both, xi) / 6))
    told = {"mm": format_number(mm, 2), "deg": format_number(deg, 2)}
    return told | {"sigmas": format_number(sigmas, 2), "far": sigmas > DRIFT_LIMIT_SIGMA}


def format_repeatability(calibration, name):
    """How far sessions, each by itself, scatter about the others: rms, mm and deg; None of one."""
    shifts = [r["shift"] for r in calibration["repeatability"] if r["sensor"] == name]
    if not shifts:
        return None
    square = np.sum(np.reshape(shifts, (-1, 2, 3)) ** 2, axis=2)
    mm, deg = np.sqrt(square.mean(0)) * [MM_PER_M, DEG_PER_RAD]
    return {
        "mm": format_number(mm, 2),
        "deg": format_number(deg, 2),
        "sessions": len(shifts),
    }


def build_session_overview(calibration, verdict, name, audit):
    """One session's verdict: what its recording lacks, and which sensors sit elsewhere in it."""
    if audit is None:
        return {"name": name, "level": "fail", "told": "not decoded"}
    faults = [s["status"]["reason"] for part in ("sensors", "bodies") for s in audit[part].values()]
    faults = list(dict.fromkeys(f for f in faults if f))
    moved = [
        f for f in verdict["findings"] if f["check"] == "sensor_moved" and f" {name} " in f["text"]
    ]
    levels = ["fail"] * bool(faults) + [f["level"] for f in moved]
    told = faults + [f["text"] for f in moved]
    return {"name": name, "level": worst_level(levels), "told": "; ".join(told) or "complete"}
