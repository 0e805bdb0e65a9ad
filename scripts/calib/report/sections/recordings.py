"""What the recordings contain: sensor streams, motion capture bodies, topics and problems."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.geometry.units import MS_PER_S, NS_PER_S
from calib.io.status import Status
from calib.report.data.run_data import Columns, ReportSession
from calib.report.number_format import DASH, format_count, format_number


def tabulate_sensor_streams(
    audit: dict[str, Any], frames: Columns, sensors: dict[str, dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return one row per sensor of a session: messages, rate, longest gap, delay, status.

    audit: log.json; frames: of frames.parquet; sensors: configs of the sensors of the session.
    """
    rows = []
    for name, config in sensors.items():
        sensor = audit["sensors"].get(name, {})
        topic = config["topic"]
        stamps_ns, log_times_ns = select_sensor_stamps(frames, name)
        rows.append(
            {
                "name": name,
                "topic": topic,
                "type": audit["topics"].get(topic, {}).get("type", DASH),
                "frame": sensor.get("frame") or DASH,
                "messages": format_count(sensor.get("messages", 0)),
                "rate": format_number(sensor.get("rate_hz", 0.0)),
                "longest_gap": format_number(find_longest_gap_s(stamps_ns)),
                "delay": format_log_delay(stamps_ns, log_times_ns),
                "is_ok": sensor.get("status", {}).get("ok", False),
                "inferred": [f"{k}: {v}" for k, v in sorted(sensor.get("inferred", {}).items())],
            }
        )
    return rows


def select_sensor_stamps(frames: Columns, sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps (n,) and log times (n,), ns, of the messages of a sensor."""
    rows = np.asarray(frames["sensor"], str) == sensor
    stamps_ns = np.asarray(frames["stamp_ns"], np.int64)
    return stamps_ns[rows], np.asarray(frames["log_time_ns"], np.int64)[rows]


def find_longest_gap_s(stamps_ns: np.ndarray) -> float | None:
    """Return the longest time, s, between two different stamps (n,), ns; None below two."""
    once = np.unique(np.asarray(stamps_ns))
    return float(np.diff(once).max() / NS_PER_S) if len(once) > 1 else None


def format_log_delay(stamps_ns: np.ndarray, log_times_ns: np.ndarray) -> str:
    """Format the delay of log times behind stamps, ms: median and 99 % quantile, `102, 108`."""
    if not len(stamps_ns):
        return DASH
    low, high = np.quantile((log_times_ns - stamps_ns) / NS_PER_S * MS_PER_S, (0.5, 0.99))
    return f"{format_number(low)}, {format_number(high)}"


def tabulate_mocap_bodies(audit: dict[str, Any], options: dict[str, Any]) -> list[dict[str, Any]]:
    """Return one row per MCS body of a session: its role, poses, rate, longest gap and faults."""
    rows = []
    targets = {t["body"]: n for n, t in options["targets"].items()}
    for name, body in sorted(audit["bodies"].items()):
        faults = [f"{format_count(n)} × {k}" for k, n in sorted(body.get("faults", {}).items())]
        rows.append(
            {
                "name": name,
                "role": "the robot" if name == options["body"] else targets.get(name, ""),
                "poses": format_count(body["poses"]),
                "rate": format_number(body.get("rate_hz")),
                "longest_gap": format_number(body.get("longest_gap_s")),
                "faults": ", ".join(faults) or "none",
                "is_ok": body["status"]["ok"],
            }
        )
    return rows


def list_log_notes(audit: dict[str, Any], mocap_notes: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Return (subject, note) on a log: unreadable parts, names, clock and repairs of each topic.

    mocap_notes: on the noise of motion capture at rest.
    """
    notes = [("parts of the log are unreadable", fault) for fault in audit.get("faults", [])]
    notes += [("a name is replaced", line) for line in audit.get("replaced_names", [])]
    for step in audit.get("clock_steps", []):
        notes.append(("a clock stepped", f"{step['text']}. {step['remedy']}"))
    for topic, block in audit.get("mocap", {}).items():
        delay_s = block["delay_s"]
        delay = f"; logged {delay_s * MS_PER_S:.0f} ms later" if delay_s is not None else ""
        notes.append((topic, "; ".join([f"time by {block['stamps']}{delay}", *block["found"]])))
    for name, sensor in audit["sensors"].items():
        if sensor.get("stamps", "header") != "header":
            notes.append((name, f"time by {sensor['stamps']}"))
    return notes + [("at rest", note) for note in mocap_notes]


def list_unused_topics(
    audit: dict[str, Any], sensors: dict[str, dict[str, Any]]
) -> list[tuple[str, str, str]]:
    """Return (topic, type, messages) of the topics of a log that are not those of the sensors."""
    used = {config["topic"] for config in sensors.values()}
    topics = sorted(audit["topics"].items())
    return [(k, t["type"], format_count(t["messages"])) for k, t in topics if k not in used]


def list_session_problems(session: ReportSession) -> list[tuple[str, Status]]:
    """Return (what failed, status) of all failures of a session, each status once."""
    steps = [
        (f"{what} {name}", Status.from_dict(block["status"]))
        for what, part in (("sensor", "sensors"), ("MCS body", "bodies"))
        for name, block in session.audit[part].items()
    ]
    steps.append(("placements", session.placements_status))
    steps += [(f"placements of {n}", s) for n, s in sorted(session.status_by_target.items())]
    for name, stream in session.streams.items():
        steps += [
            (f"initial guess of {name}", Status.from_dict(stream.guess["status"])),
            (f"views of {name}", stream.views_status),
            (f"keypoints of {name}", stream.keypoints_status),
        ]
    steps_by_status: dict[Status, list[str]] = {}
    for step, status in steps:
        if not status.ok:
            steps_by_status.setdefault(status, []).append(step)
    return [(", ".join(names), status) for status, names in steps_by_status.items()]
