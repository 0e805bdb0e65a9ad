"""Findings of preflight: what the recordings of a rig support before anything is solved."""

from dataclasses import replace
from typing import Any

import numpy as np

from calib.diagnosis.observability import (
    MOUNT_DIRECTION_NAMES,
    advise_views,
    direction_spread_deg,
    normals_and_axes,
    single_rotation_axis,
)
from calib.diagnosis.sensor_status import find_floating_sensors
from calib.geometry.se3 import pose_from_xyz_quat
from calib.io.pose_block import pose_from_config
from calib.io.status import Status
from calib.verdict.findings import Finding, make_finding
from calib.verdict.model_error_findings import (
    clock_step_findings,
    undetermined_mount_findings,
)
from calib.verdict.preflight_guess import PreflightSession
from calib.verdict.preflight_visibility import SensorVisibility
from calib.verdict.rig_verdict import Verdict, make_verdict, view_findings
from calib.views.pose_selection import select_new_poses
from calib.views.target_placements import (
    compute_target_poses,
    find_still_rows,
    mounts_from_guess,
)

MIN_AXIS_COSINE = 0.9  # minimum component of a direction that is called by the name of one axis
NO_MOTION_TEXT = "time offset not observable: no relative motion in its view"
NO_MOTION_REMEDY = (
    "Move target or robot smoothly between placements, at 0.1 to 0.5 m/s, in view of the sensor."
)

Visibility = dict[str, dict[str, SensorVisibility]]  # by sensor and session
Sessions = dict[str, PreflightSession]


def preflight_rig_findings(
    sessions: Sessions, visibility: Visibility, options: dict[str, Any]
) -> Verdict:
    """Judge what the recordings support. Fails if no sensor can be calibrated.

    options: of scripts/preflight.py.
    """
    found = [
        *preflight_status_findings(visibility, len(sessions)),
        *clock_step_findings({name: session.audit for name, session in sessions.items()}),
        *preflight_target_findings(sessions, options),
    ]
    for name, by_session in visibility.items():
        found += preflight_sensor_findings(name, list(by_session.values()), options)
    verdict = make_verdict(found, list(visibility))
    if set(verdict.levels.values()) == {"fail"}:
        return verdict._replace(level="fail")
    return verdict._replace(level="warn" if found else "pass")


def preflight_status_findings(visibility: Visibility, n_sessions: int) -> list[Finding]:
    """Return one finding for each reason why sensors see no target at all.

    Fails sensors that see no target in any session. n_sessions: number of all sessions.
    """
    places: dict[tuple[str, Status], list[tuple[str, str]]] = {}
    for name, by_session in visibility.items():
        level = "warn" if any(v.status.ok for v in by_session.values()) else "fail"
        for session, seen in by_session.items():
            if not seen.status.ok:
                places.setdefault((level, seen.status), []).append((name, session))
    return [
        _status_finding(level, status, at, n_sessions > 1) for (level, status), at in places.items()
    ]


def _status_finding(
    level: str, status: Status, places: list[tuple[str, str]], names_sessions: bool
) -> Finding:
    names = sorted({name for name, _ in places})
    subject = ", ".join(names)
    if names_sessions:
        subject += f" in {', '.join(sorted({session for _, session in places}))}"
    text = f"{subject}: {_describe_status(status)}"
    return make_finding("status", names, level, text=text, remedy=status.remedy)


def _describe_status(status: Status) -> str:
    return f"{status.reason}; found {status.found}" if status.found else status.reason


def preflight_sensor_findings(
    name: str, visibilities: list[SensorVisibility], options: dict[str, Any]
) -> list[Finding]:
    """Return the findings on placements in view, target directions and motion of one sensor.

    visibilities: of the sensor, by session.
    """
    visibilities = [v for v in visibilities if v.status.ok]
    if not visibilities:
        return []
    expected, possible = (
        view_findings(name, visibility_summary(visibilities, reasons), options["judge"])
        for reasons in ("expected_reasons", "possible_reasons")
    )
    # A target out of view from the stated pose may be in view from the true one: warn only.
    certain = {f["check"] for f in possible if f["level"] == "fail"}
    out = [f if f["check"] in certain else _as_warning(f) for f in expected]
    has_times = any(v.has_measurement_time for v in visibilities)
    if options["time_offset"] and has_times and not any(v.n_moving_views for v in visibilities):
        text = f"{name}: {NO_MOTION_TEXT}"
        out.append(
            make_finding("time_offset_s", [name], "warn", text=text, remedy=NO_MOTION_REMEDY)
        )
    return out


def _as_warning(finding: Finding) -> Finding:
    warning = finding.copy()
    warning["level"] = "warn"
    return warning


def visibility_summary(visibilities: list[SensorVisibility], reasons_field: str) -> dict[str, Any]:
    """Return the keys of one sensor that view_findings reads.

    reasons_field: expected_reasons or possible_reasons.
    """
    targets = [t for v in visibilities for t in v.visibility_by_target.values()]
    in_view = [
        (t.shape, T)
        for t in targets
        for T, reason in zip(t.T_robot_target, getattr(t, reasons_field), strict=True)
        if not reason
    ]
    shapes = [shape for shape, _ in in_view]
    T_robot_target = np.reshape([T for _, T in in_view], (-1, 4, 4))
    kind, directions = visibilities[0].kind, normals_and_axes(shapes, T_robot_target)
    return {
        "kind": kind,
        "placements": len(shapes),
        "direction_spread_deg": direction_spread_deg(directions),
        "recording_advice": advise_views(directions, len(shapes), kind == "lidar"),
    }


def preflight_target_findings(sessions: Sessions, options: dict[str, Any]) -> list[Finding]:
    """Return the findings on targets that are never still, and on undetermined mounts."""
    out = []
    for name, session in sessions.items():
        out += _moving_target_findings(name, session)
    for target, config in sorted(options["targets"].items()):
        T = new_target_poses(sessions, target, options)
        if len(T) < options["judge"]["fail_placements"] or "mount" in config:
            continue
        axis = single_rotation_axis(T)
        if options["target_alignment"] and axis is not None:
            direction = pose_from_config(config["T_body_target"])[:3, :3].T @ axis
            out += undetermined_mount_findings(target, [describe_mount_direction(direction)])
    return out


def _moving_target_findings(session_name: str, session: PreflightSession) -> list[Finding]:
    """Return one finding for each target that is never still, if another target is."""
    placements = session.placements
    failed = {t: status for t, status in placements.target_status.items() if not status.ok}
    if not placements.status.ok or len(failed) == len(placements.target_status):
        return []
    return [
        make_finding(
            "status",
            [],
            "warn",
            text=f"{target} in {session_name}: {_describe_status(status)}",
            remedy=status.remedy,
        )
        for target, status in sorted(failed.items())
    ]


def new_target_poses(sessions: Sessions, target: str, options: dict[str, Any]) -> np.ndarray:
    """Return T_robot_body (n, 4, 4) of all placements of a target that crop counts as new."""
    mounts = mounts_from_guess({target: options["targets"][target]}, {"mounts": {}})
    parts = []
    for session in sessions.values():
        columns = session.placements.columns
        T_robot_target = compute_target_poses(columns, mounts)
        rows = select_new_poses(T_robot_target, find_still_rows(columns, target), options["crop"])
        T_robot_body = pose_from_xyz_quat(columns["xyz"], columns["quat"])
        parts.append(T_robot_body[np.sort(rows)])
    return np.concatenate([np.zeros((0, 4, 4)), *parts])


def reject_floating_sensors(
    visibility: Visibility, sessions: Sessions, options: dict[str, Any]
) -> Visibility:
    """Return the visibility with a failed status for each sensor that solve will not determine.

    See find_floating_sensors: only targets with unknown mounts are in its view.
    """
    targets_by_sensor = {
        name: {
            target
            for v in by_session.values()
            for target, seen in v.visibility_by_target.items()
            if v.status.ok and "" in seen.possible_reasons
        }
        for name, by_session in visibility.items()
    }
    T_robot_body = {
        name: new_target_poses(sessions, name, options)
        for name, block in options["targets"].items()
        if "mount" in block
    }
    floating = find_floating_sensors(targets_by_sensor, T_robot_body)
    return {
        name: {
            s: replace(v, status=floating[name]) if name in floating and v.status.ok else v
            for s, v in by_session.items()
        }
        for name, by_session in visibility.items()
    }


def describe_mount_direction(direction: np.ndarray) -> str:
    """Return the translation of a target along a unit vector (3,) of its frame as text."""
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > MIN_AXIS_COSINE:
        return MOUNT_DIRECTION_NAMES[axis]
    return f"translation along ({', '.join(f'{v:.2f}' for v in direction)})"
