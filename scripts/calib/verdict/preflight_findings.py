"""What follows for a calibration from what its sensors may see: findings, and numbers as JSON."""

import numpy as np

from calib.diagnosis import observability
from calib.geometry import se3
from calib.io import pose_block
from calib.verdict import findings, model_error_findings, rig_verdict

AXIS = 0.9  # least component of a direction that is named by one axis
NO_MOTION = "clock not observable: no relative motion in its view"
MOVE = "carry target or robot on smoothly between placements, 0.1 to 0.5 m/s, in its view"


def of_rig(sessions, looks, options):
    """(level, findings in order of importance, level per sensor) before anything is solved; it
    fails where no sensor can be calibrated.

    sessions: {name: looks.Session}; looks: {sensor: {session: looks.Look}}; options: of
    scripts/preflight.py.
    """
    found = [*statuses(looks, len(sessions)), *of_targets(sessions, options)]
    for name, by_session in looks.items():
        found += of_sensor(name, list(by_session.values()), options)
    found.sort(
        key=lambda f: (-findings.LEVELS.index(f["level"]), rig_verdict.CHECKS.index(f["check"]))
    )
    levels = {n: findings.worst(f["level"] for f in found if n in f["sensors"]) for n in looks}
    if set(levels.values()) == {"fail"}:
        return "fail", found, levels
    return ("warn" if found else "pass"), found, levels


def statuses(looks, sessions):
    """Findings on what keeps sensors from seeing anything, each told once for all of them; it fails
    those that see nothing in any session. sessions: how many there are."""
    told = {}
    for name, by_session in looks.items():
        level = "warn" if any(look.status.ok for look in by_session.values()) else "fail"
        for session, look in by_session.items():
            if not look.status.ok:
                told.setdefault((level, look.status), []).append((name, session))
    return [_status(level, status, places, sessions) for (level, status), places in told.items()]


def _status(level, status, places, sessions):
    names = sorted({name for name, _ in places})
    where = sorted({session for _, session in places}) if sessions > 1 else []
    parts = [", ".join(names), *(["in " + ", ".join(where)] if where else [])]
    text = f"{' '.join(parts)}: {status.reason}"
    text += f"; found {status.found}" if status.found else ""
    return findings.finding("status", names, level, text, status.remedy)


def of_sensor(name, looks, options):
    """Findings on how many placements one sensor may see, on how their directions differ, and on
    whether anything tells its clock."""
    looks = [look for look in looks if look.status.ok]
    if not looks:
        return []
    expected, possible = (
        rig_verdict.of_views(name, views(looks, which), options["judge"])
        for which in ("expected", "possible")
    )
    # What is out of view from where the sensor is said to be may be in view from where it is.
    certain = {f["check"] for f in possible if f["level"] == "fail"}
    found = [f if f["check"] in certain else f | {"level": "warn"} for f in expected]
    moving = sum(s.in_motion for look in looks for s in look.seen.values())
    if options["time_offset"] and any(look.timed for look in looks) and not moving:
        found.append(findings.finding("offset_s", [name], "warn", f"{name}: {NO_MOTION}", MOVE))
    return found


def views(looks, which):
    """What verdict.of_views asks of a sensor with some Looks; which: expected or possible."""
    seen = [s for look in looks for s in look.seen.values()]
    inside = [(s.shape, T) for s in seen for T in s.T[[not why for why in getattr(s, which)]]]
    shapes, T = [shape for shape, _ in inside], np.reshape([T for _, T in inside], (-1, 4, 4))
    kind, directions = looks[0].kind, observability.axes(shapes, T)
    return {
        "kind": kind,
        "placements": len(shapes),
        "tilt": observability.tilts(directions),
        "advice": observability.advice(directions, len(shapes), kind == "lidar"),
    }


def of_targets(sessions, options):
    """Findings on targets that are never still in a session where others are, and on those whose
    place in their body nothing tells."""
    out = []
    for name, session in sessions.items():
        held = {t: s for t, s in session.targets.items() if session.status.ok and not s.ok}
        if len(held) < len(session.targets):
            out += [
                findings.finding("status", [], "warn", f"{t} in {name}: {s.reason}", s.remedy)
                for t, s in sorted(held.items())
            ]
    for target, config in sorted(options["targets"].items()):
        T = placed(sessions, target)
        told = len(T) < options["judge"]["fail_placements"] or "mount" in config
        axis = None if told else observability.hinge(T)
        if options["target_alignment"] and axis is not None:
            along = pose_block.pose(config["T_body_target"])[:3, :3].T @ axis
            out += model_error_findings.of_mount(target, [in_words(along)])
    return out


def placed(sessions, target):
    """T_robot_body (n, 4, 4) of all placements of a target."""
    columns = [s.placements for s in sessions.values()]
    rows = [(p["target"] == target) & (p["kind"] == "still") for p in columns]
    xyz, quat = (
        np.concatenate([p[k][r].reshape(-1, n) for p, r in zip(columns, rows, strict=True)])
        for k, n in (("xyz", 3), ("quat", 4))
    )
    return se3.from_xyz_quat(xyz, quat)


def in_words(direction):
    """A target's place along a unit vector (3,) of its frame."""
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > AXIS:
        return observability.MOUNT[axis]
    return f"its place along ({', '.join(f'{v:.2f}' for v in direction)})"


def turns(sessions, options):
    """{target: {placements, turns_deg}} for preflight.json: by how much it turns in front of the
    robot about its three main axes, rms, or null where there are too few placements to say."""
    out = {}
    for target in sorted(options["targets"]):
        T = placed(sessions, target)
        rms = observability.turns(T)[0].tolist() if len(T) > 2 else None
        out[target] = {"placements": len(T), "turns_deg": rms}
    return out


def numbers(looks):
    """{sensor: {placements, tilt_deg, views_in_motion, sessions}} for preflight.json: how many
    placements are in view as stated and at most, by how much the directions of the targets differ
    in these, and session by session what is seen and what lost, and why."""
    out = {}
    for name, by_session in looks.items():
        good = [look for look in by_session.values() if look.status.ok]
        stated = all(s.stated for look in good for s in look.seen.values())
        out[name] = {
            "placements": {
                "expected": views(good, "expected")["placements"] if good and stated else None,
                "possible": views(good, "possible")["placements"] if good else 0,
            },
            "tilt_deg": views(good, "possible")["tilt"] if good else {},
            "views_in_motion": sum(s.in_motion for look in good for s in look.seen.values()),
            "sessions": {session: _session(look) for session, look in by_session.items()},
        }
    return out


def _session(look):
    return {
        "status": look.status.to_dict(),
        "pose_from": look.source,
        "during_mocap": look.known,
        "targets": {
            name: {
                "placements": len(s.T),
                "expected": s.expected.count("") if s.stated else None,
                "possible": s.possible.count(""),
                "lost": s.lost(),
                "views_in_motion": s.in_motion,
            }
            for name, s in look.seen.items()
        },
    }
