"""What the recordings held: streams, bodies, topics, and what was wrong with them."""

import numpy as np

from calib.geometry.units import MS_PER_S, NS_PER_S
from calib.io.status import Status
from calib.report.number_format import DASH, format_count, format_number


def tabulate_sensor_streams(run, session):
    """Rows of one session's audit: a sensor's messages, rate, intervals, delay and status."""
    heard, rows = run.sessions[session], []
    for name in heard.streams:
        audit = heard.audit["sensors"].get(name, {})
        topic = run.options["sensors"][name]["topic"]
        t, log_t = select_sensor_stamps(run, session, name)
        rows.append(
            {
                "name": name,
                "topic": topic,
                "type": heard.audit["topics"].get(topic, {}).get("type", DASH),
                "frame": audit.get("frame") or DASH,
                "messages": format_count(audit.get("messages", 0)),
                "rate": format_number(audit.get("rate_hz", 0.0)),
                "gap": format_number(find_longest_gap(t)),
                "delay": format_log_delay(t, log_t),
                "ok": audit.get("status", {}).get("ok", False),
                "told": [f"{k}: {v}" for k, v in sorted(audit.get("inferred", {}).items())],
            }
        )
    return rows


def select_sensor_stamps(run, session, sensor):
    """Stamps (n,) of a sensor's messages and when the log took them (n,), ns."""
    frames = run.sessions[session].frames
    own = np.asarray(frames["sensor"], str) == sensor
    return np.asarray(frames["stamp_ns"], np.int64)[own], np.asarray(
        frames["log_time_ns"], np.int64
    )[own]


def find_longest_gap(t):
    """Longest time, s, between two stamps t (n,), ns, repeats allowed; None below two."""
    once = np.unique(np.asarray(t))
    return float(np.diff(once).max() / NS_PER_S) if len(once) > 1 else None


def format_log_delay(t, log_t):
    """`102, 108`: median and 99 % of what the log is later than the stamps, ms."""
    if not len(t):
        return DASH
    low, high = np.quantile((log_t - t) / NS_PER_S * MS_PER_S, (0.5, 0.99))
    return f"{format_number(low)}, {format_number(high)}"


def tabulate_mocap_bodies(run, session):
    """Rows of one session's audit of the MCS: a body's poses, rate, longest gap, faults, status."""
    rows = []
    targets = {t["body"]: n for n, t in run.options["targets"].items()}
    for name, audit in sorted(run.sessions[session].audit["bodies"].items()):
        faults = ", ".join(
            f"{format_count(n)} × {k}" for k, n in sorted(audit.get("faults", {}).items())
        )
        role = "the robot" if name == run.options["body"] else targets.get(name, "")
        rows.append(
            {
                "name": name,
                "role": role,
                "poses": format_count(audit["poses"]),
                "rate": format_number(audit.get("rate_hz")),
                "gap": format_number(audit.get("longest_gap_s")),
                "faults": faults or "none",
                "ok": audit["status"]["ok"],
            }
        )
    return rows


def list_log_notes(run, session):
    """(what, in words) of a session's log: what could not be read, and of every topic of motion
    capture whose times are used and what else was found and done about its poses."""
    audit = run.sessions[session].audit
    said = [("not all could be read", fault) for fault in audit.get("faults", [])]
    for topic, about in audit.get("mocap", {}).items():
        late = about["delay_s"]
        delay = f"; taken by the log {late * 1e3:.0f} ms after" if late is not None else ""
        words = "; ".join([f"time by {about['stamps']}{delay}", *about["found"]])
        said.append((topic, words))
    for name, sensor in audit["sensors"].items():
        if sensor.get("stamps", "header") != "header":
            said.append((name, f"time by {sensor['stamps']}"))
    return said


def list_unused_topics(run, session):
    """(topic, type, messages) of what the log holds beside the sensors used."""
    used = {run.options["sensors"][n]["topic"] for n in run.sessions[session].streams}
    found = sorted(run.sessions[session].audit["topics"].items())
    return [(k, t["type"], format_count(t["messages"])) for k, t in found if k not in used]


def list_session_problems(run, session):
    """(where, status) of everything in a session that could not be done, each fault once."""
    s = run.sessions[session]
    found = [(f"sensor {n}", Status.from_dict(a["status"])) for n, a in s.audit["sensors"].items()]
    found += [
        (f"MCS body {n}", Status.from_dict(a["status"])) for n, a in s.audit["bodies"].items()
    ]
    found += [("placements", s.placements_status)]
    found += [(f"placements of {n}", status) for n, status in sorted(s.status_by_target.items())]
    for name, stream in s.streams.items():
        guess = Status.from_dict(stream.guess["status"])
        steps = (
            ("first guess", guess),
            ("views", stream.views_status),
            ("keypoints", stream.keypoints_status),
        )
        found += [(f"{what} of {name}", status) for what, status in steps]
    once = {}
    for where, status in found:
        if not status.ok:
            once.setdefault(status, []).append(where)
    return [(", ".join(where), status) for status, where in once.items()]
