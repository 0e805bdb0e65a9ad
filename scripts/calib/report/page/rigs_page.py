"""Context of the page of all rigs: verdict, σ, drift since the last acceptance, repeatability."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.geometry.se3 import invert_pose, se3_log
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.number_format import DASH, format_number
from calib.report.sections.extrinsics import pose_distance_mm_deg
from calib.verdict.findings import worst_level

DRIFT_LIMIT_SIGMA = 3.0  # larger drifts are marked

Block = dict[str, Any]  # content of a JSON file or a part of it


def build_rig_overview(
    calibration: Block,
    verdict: Block,
    accepted: Sequence[tuple[str, Block]],
    audits: dict[str, Block | None],
) -> Block:
    """Return the overview of one rig.

    calibration, verdict: content of the JSON files; accepted: (name, calibration.json) accepted
    before this one, the oldest first; audits: log.json by session, None without one.
    """
    last_name, last = accepted[-1] if accepted else (None, {"sensors": {}})
    reasons = verdict["reasons"]
    return {
        "level": verdict["verdict"],
        "reason": reasons[0] if reasons else "All sensors are within all limits.",
        "n_more_reasons": max(len(reasons) - 1, 0),
        "n_accepted": len(accepted),
        "last_accepted": last_name,
        "sensors": [
            build_sensor_overview(calibration, verdict, name, last["sensors"].get(name))
            for name in sorted(calibration["sensors"])
        ],
        "sessions": [
            build_session_overview(verdict, name, audit) for name, audit in sorted(audits.items())
        ],
    }


def build_sensor_overview(
    calibration: Block, verdict: Block, name: str, accepted_sensor: Block | None
) -> Block:
    """Return the verdict of one sensor, the largest σ of its pose, drift and repeatability."""
    sensor = calibration["sensors"][name]
    sigma_mm, sigma_deg = DASH, DASH
    if sensor["covariance"]:
        sigma_m, sigma_rad = np.sqrt(np.diag(sensor["covariance"])).reshape(2, 3).max(1)
        sigma_mm = format_number(sigma_m * MM_PER_M, 2)
        sigma_deg = format_number(sigma_rad * DEG_PER_RAD, 2)
    return {
        "name": name,
        "kind": sensor["kind"],
        "level": verdict["sensors"][name],
        "sigma_mm": sigma_mm,
        "sigma_deg": sigma_deg,
        "drift": format_pose_drift(sensor, accepted_sensor),
        "repeatability": format_repeatability(calibration, name),
        "reason": sensor["status"]["reason"],
    }


def format_pose_drift(sensor: Block, accepted_sensor: Block | None) -> Block | None:
    """Return the drift since the accepted pose: mm, deg, in σ of both; None without both poses."""
    if not accepted_sensor or not sensor["T_robot_sensor"] or not accepted_sensor["T_robot_sensor"]:
        return None
    T, T_accepted = (np.array(s["T_robot_sensor"]["matrix"]) for s in (sensor, accepted_sensor))
    mm, deg = pose_distance_mm_deg(T, T_accepted)
    xi = se3_log(invert_pose(T_accepted) @ T)
    covariance = np.array(sensor["covariance"]) + np.array(accepted_sensor["covariance"])
    sigmas = float(np.sqrt(xi @ np.linalg.solve(covariance, xi) / 6))
    return {
        "mm": format_number(mm, 2),
        "deg": format_number(deg, 2),
        "sigmas": format_number(sigmas, 2),
        "is_far": sigmas > DRIFT_LIMIT_SIGMA,
    }


def format_repeatability(calibration: Block, name: str) -> Block | None:
    """Return the rms deviation of single sessions from the others, mm and deg; None of one."""
    shifts = [r["shift"] for r in calibration["repeatability"] if r["sensor"] == name]
    if not shifts:
        return None
    squares = np.sum(np.reshape(shifts, (-1, 2, 3)) ** 2, axis=2)
    mm, deg = np.sqrt(squares.mean(0)) * [MM_PER_M, DEG_PER_RAD]
    return {"mm": format_number(mm, 2), "deg": format_number(deg, 2)}


def build_session_overview(verdict: Block, name: str, audit: Block | None) -> Block:
    """Return the verdict of one session: problems of the recording, and sensors that moved."""
    if audit is None:
        return {"name": name, "level": "fail", "notes": "not decoded"}
    blocks = [block for part in ("sensors", "bodies") for block in audit[part].values()]
    problems = list(dict.fromkeys(reason for b in blocks if (reason := b["status"]["reason"])))
    moves = [
        f for f in verdict["findings"] if f["check"] == "sensor_moved" and f" {name} " in f["text"]
    ]
    levels = ["fail"] * bool(problems) + [f["level"] for f in moves]
    notes = problems + [f["text"] for f in moves]
    return {"name": name, "level": worst_level(levels), "notes": "; ".join(notes) or "complete"}
