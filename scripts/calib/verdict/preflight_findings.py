"""What follows for a calibration from what its sensors may see: findings, and numbers as JSON."""

import numpy as np

from calib.diagnosis.observability import (
    MOUNT_DIRECTION_NAMES,
    advise_views,
    direction_spread_deg,
    normals_and_axes,
    rotation_spread_deg,
    single_rotation_axis,
)
from calib.geometry.se3 import pose_from_xyz_quat
from calib.io.pose_block import pose_from_config
from calib.verdict.findings import VERDICT_LEVELS, make_finding, worst_level
from calib.verdict.model_error_findings import undetermined_mount_findings
from calib.verdict.rig_verdict import CHECKS_BY_IMPORTANCE, view_findings

MIN_AXIS_COSINE = 0.9  # least component of a direction that is named by one axis
NO_MOTION_TEXT = "clock not observable: no relative motion in its view"
NO_MOTION_REMEDY = (
    "carry target or robot on smoothly between placements, 0.1 to 0.5 m/s, in its view"
)


def preflight_rig_findings(sessions, visibility, options):
    """(level, findings in order of importance, level per sensor) before anything is solved; it
    fails where no sensor can be calibrated.

    sessions: {name: looks.Session}; visibility: {sensor: {session: looks.Look}}; options: of
    scripts/preflight.py.
    """
    found = [
        *preflight_status_findings(visibility, len(sessions)),
        *preflight_target_findings(sessions, options),
    ]
    for name, by_session in visibility.items():
        found += preflight_sensor_findings(name, list(by_session.values()), options)
    found.sort(
        key=lambda f: (-VERDICT_LEVELS.index(f["level"]), CHECKS_BY_IMPORTANCE.index(f["check"]))
    )
    levels = {n: worst_level(f["level"] for f in found if n in f["sensors"]) for n in visibility}
    if set(levels.values()) == {"fail"}:
        return "fail", found, levels
    return ("warn" if found else "pass"), found, levels


def preflight_status_findings(visibility, n_sessions):
    """Findings on what keeps sensors from seeing anything, each told once for all of them; it fails
    those that see nothing in any session. n_sessions: how many there are."""
    told = {}
    for name, by_session in visibility.items():
        level = "warn" if any(look.status.ok for look in by_session.values()) else "fail"
        for session, look in by_session.items():
            if not look.status.ok:
                told.setdefault((level, look.status), []).append((name, session))
    return [
        _status_finding(level, status, places, n_sessions)
        for (level, status), places in told.items()
    ]


def _status_finding(level, status, places, sessions):
    names = sorted({name for name, _ in places})
    where = sorted({session for _, session in places}) if sessions > 1 else []
    parts = [", ".join(names), *(["in " + ", ".join(where)] if where else [])]
    text = f"{' '.join(parts)}: {status.reason}"
    text += f"; found {status.found}" if status.found else ""
    return make_finding("status", names, level, text, status.remedy)


def preflight_sensor_findings(name, visibilities, options):
    """Findings on how many placements one sensor may see, on how their directions differ, and on
    whether anything tells its clock."""
    visibilities = [look for look in visibilities if look.status.ok]
    if not visibilities:
        return []
    expected, possible = (
        view_findings(name, visibility_summary(visibilities, which), options["judge"])
        for which in ("expected_reasons", "possible_reasons")
    )
    # What is out of view from where the sensor is said to be may be in view from where it is.
    certain = {f["check"] for f in possible if f["level"] == "fail"}
    found = [f if f["check"] in certain else f | {"level": "warn"} for f in expected]
    moving = sum(
        s.n_moving_views for look in visibilities for s in look.visibility_by_target.values()
    )
    if (
        options["time_offset"]
        and any(look.has_measurement_time for look in visibilities)
        and not moving
    ):
        found.append(
            make_finding(
                "time_offset_s", [name], "warn", f"{name}: {NO_MOTION_TEXT}", NO_MOTION_REMEDY
            )
        )
    return found


def visibility_summary(visibilities, reasons_field):
    """What verdict.of_views asks of a sensor with some Looks; reasons_field: expected or possible."""
    seen = [s for look in visibilities for s in look.visibility_by_target.values()]
    inside = [
        (s.shape, T)
        for s in seen
        for T in s.T_robot_target[[not why for why in getattr(s, reasons_field)]]
    ]
    shapes, T = [shape for shape, _ in inside], np.reshape([T for _, T in inside], (-1, 4, 4))
    kind, directions = visibilities[0].kind, normals_and_axes(shapes, T)
    return {
        "kind": kind,
        "placements": len(shapes),
        "tilt": direction_spread_deg(directions),
        "advice": advise_views(directions, len(shapes), kind == "lidar"),
    }


def preflight_target_findings(sessions, options):
    """Findings on targets that are never still in a session where others are, and on those whose
    place in their body nothing tells."""
    out = []
    for name, session in sessions.items():
        placements = session.placements
        held = {
            t: s for t, s in placements.target_status.items() if placements.status.ok and not s.ok
        }
        if len(held) < len(placements.target_status):
            out += [
                make_finding("status", [], "warn", f"{t} in {name}: {s.reason}", s.remedy)
                for t, s in sorted(held.items())
            ]
    for target, config in sorted(options["targets"].items()):
        T = still_target_poses(sessions, target)
        told = len(T) < options["judge"]["fail_placements"] or "mount" in config
        axis = None if told else single_rotation_axis(T)
        if options["target_alignment"] and axis is not None:
            along = pose_from_config(config["T_body_target"])[:3, :3].T @ axis
            out += undetermined_mount_findings(target, [describe_mount_direction(along)])
    return out


def still_target_poses(sessions, target):
    """T_robot_body (n, 4, 4) of all placements of a target."""
    columns = [s.placements for s in sessions.values()]
    rows = [(p["target"] == target) & (p["kind"] == "still") for p in columns]
    xyz, quat = (
        np.concatenate([p[k][r].reshape(-1, n) for p, r in zip(columns, rows, strict=True)])
        for k, n in (("xyz", 3), ("quat", 4))
    )
    return pose_from_xyz_quat(xyz, quat)


def describe_mount_direction(direction):
    """A target's place along a unit vector (3,) of its frame."""
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > MIN_AXIS_COSINE:
        return MOUNT_DIRECTION_NAMES[axis]
    return f"its place along ({', '.join(f'{v:.2f}' for v in direction)})"


def target_turns_json(sessions, options):
    """{target: {placements, turns_deg}} for preflight.json: by how much it turns in front of the
    robot about its three main axes, rms, or null where there are too few placements to say."""
    out = {}
    for target in sorted(options["targets"]):
        T = still_target_poses(sessions, target)
        rms = rotation_spread_deg(T)[0].tolist() if len(T) > 2 else None
        out[target] = {"placements": len(T), "turns_deg": rms}
    return out


def sensor_visibility_json(visibility):
    """{sensor: {placements, tilt_deg, views_in_motion, sessions}} for preflight.json: how many
    placements are in view as stated and at most, by how much the directions of the targets differ
    in these, and session by session what is seen and what lost, and why."""
    out = {}
    for name, by_session in visibility.items():
        good = [look for look in by_session.values() if look.status.ok]
        stated = all(s.has_known_pose for look in good for s in look.visibility_by_target.values())
        out[name] = {
            "placements": {
                "expected": visibility_summary(good, "expected_reasons")["placements"]
                if good and stated
                else None,
                "possible": visibility_summary(good, "possible_reasons")["placements"]
                if good
                else 0,
            },
            "tilt_deg": visibility_summary(good, "possible_reasons")["tilt"] if good else {},
            "views_in_motion": sum(
                s.n_moving_views for look in good for s in look.visibility_by_target.values()
            ),
            "sessions": {
                session: _session_visibility_json(look) for session, look in by_session.items()
            },
        }
    return out


def _session_visibility_json(look):
    return {
        "status": look.status.to_dict(),
        "pose_from": look.pose_source,
        "during_mocap": look.mocap_coverage,
        "targets": {
            name: {
                "placements": len(s.T_robot_target),
                "expected": s.expected_reasons.count("") if s.has_known_pose else None,
                "possible": s.possible_reasons.count(""),
                "lost": s.count_lost_placements(),
                "views_in_motion": s.n_moving_views,
            }
            for name, s in look.visibility_by_target.items()
        },
    }
