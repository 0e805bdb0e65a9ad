"""What follows for a calibration from what its sensors may see: findings, and numbers as JSON."""

import numpy as np

from calib import geometry, observability, rig, verdict

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
    found.sort(key=lambda f: (-verdict.LEVELS.index(f["level"]), verdict.CHECKS.index(f["check"])))
    levels = {n: verdict.worst(f["level"] for f in found if n in f["sensors"]) for n in looks}
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
    return verdict.finding("status", names, level, text, status.remedy)


def of_sensor(name, looks, options):
    """Findings on how many placements one sensor may see, on how their directions differ, and on
    whether anything tells its clock."""
    looks = [look for look in looks if look.status.ok]
    if not looks:
        return []
    expected, possible = (
        verdict.of_views(name, views(looks, which), options["judge"])
        for which in ("expected", "possible")
    )
    # What is out of view from where the sensor is said to be may be in view from where it is.
    certain = {f["check"] for f in possible if f["level"] == "fail"}
    found = [f if f["check"] in certain else f | {"level": "warn"} for f in expected]
    moving = sum(s.in_motion for look in looks for s in look.seen.values())
    if options["time_offset"] and any(look.timed for look in looks) and not moving:
        found.append(verdict.finding("offset_s", [name], "warn", f"{name}: {NO_MOTION}", MOVE))
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
                verdict.finding("status", [], "warn", f"{t} in {name}: {s.reason}", s.remedy)
                for t, s in sorted(held.items())
            ]
    for target, config in sorted(options["targets"].items()):
        axis = None if "mount" in config else hinge(sessions, target, options["judge"])
        if options["target_alignment"] and axis is not None:
            along = rig.pose(config["T_body_target"])[:3, :3].T @ axis
            out += verdict.of_mount(target, [in_words(along)])
    return out


def hinge(sessions, target, limits):
    """The one axis (3,) of its body that a target turns about in front of the robot in all of its
    placements, or None (observability.hinge)."""
    T = []
    for session in sessions.values():
        p = session.placements
        rows = (p["target"] == target) & (p["kind"] == "still")
        T.append(geometry.from_xyz_quat(p["xyz"][rows], p["quat"][rows]).reshape(-1, 4, 4))
    T = np.concatenate(T)
    return observability.hinge(T) if len(T) >= limits["fail_placements"] else None


def in_words(direction):
    """A target's place along a unit vector (3,) of its frame."""
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > AXIS:
        return observability.MOUNT[axis]
    return f"its place along ({', '.join(f'{v:.2f}' for v in direction)})"


def numbers(looks):
    """{sensor: {placements, sessions}} for preflight.json: how many placements are in view for
    certain as stated and at most, and session by session what is seen and what lost, and why."""
    out = {}
    for name, by_session in looks.items():
        good = [look for look in by_session.values() if look.status.ok]
        stated = all(look.source != "none" for look in good)
        out[name] = {
            "placements": {
                "expected": views(good, "expected")["placements"] if good and stated else None,
                "possible": views(good, "possible")["placements"] if good else 0,
            },
            "tilt_deg": views(good, "possible")["tilt"] if good else {},
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
                "expected": None if look.source == "none" else s.expected.count(""),
                "possible": s.possible.count(""),
                "lost": s.lost(),
                "views_in_motion": s.in_motion,
            }
            for name, s in look.seen.items()
        },
    }
