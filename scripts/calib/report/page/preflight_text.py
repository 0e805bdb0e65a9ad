"""The preflight of a rig as lines for the terminal: recordings, visibility, then the verdict."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from calib.report.data.run_data import Columns
from calib.report.number_format import DASH, format_plural
from calib.report.sections.recordings import (
    list_log_notes,
    tabulate_mocap_bodies,
    tabulate_sensor_streams,
)


class AuditedSession(Protocol):
    """A recording after decode: log.json, and the columns of frames.parquet."""

    @property
    def audit(self) -> dict[str, Any]:
        """Content of log.json."""

    @property
    def frames(self) -> Columns:
        """Columns of frames.parquet."""

    @property
    def mocap_notes(self) -> Sequence[str]:
        """On the noise of motion capture at rest."""


UNKNOWN_POSE_NOTE = "is not stated: it is estimated from the data; all placements count as visible"


def format_preflight(
    rig: str,
    preflight: dict[str, Any],
    sessions: Mapping[str, AuditedSession],
    options: dict[str, Any],
) -> list[str]:
    """Return the lines on the sessions of a rig, what its sensors see, and the verdict.

    preflight: content of preflight.json; options: with sensors, targets, body and sessions.
    """
    lines = []
    for name, session in sessions.items():
        sensors = {n: options["sensors"][n] for n in options["sessions"][name]["sensors"]}
        lines.append(f"{rig}, session {name}")
        lines += _indent_lines(format_session_audit(session, sensors, options))
    notes = list_unknown_poses(preflight)
    lines += [
        f"{rig}: placements visible to each sensor, by its stated pose and its field of view",
        *_indent_lines(format_placement_table(preflight)),
        "",
        *_indent_lines([*notes, ""] if notes else []),
        *_indent_lines(format_sensor_table(preflight)),
        "",
        *_indent_lines(format_rotation_table(preflight)),
        "",
    ]
    return lines + format_preflight_verdict(rig, preflight)


def format_session_audit(
    session: AuditedSession, sensors: dict[str, dict[str, Any]], options: dict[str, Any]
) -> list[str]:
    """Return the lines on the content of a log and its problems; sensors: their configs."""
    bodies = [["motion capture", "", "poses", "rate", "longest gap", "faults"]]
    bodies += [
        [r["name"], r["role"], r["poses"], f"{r['rate']} Hz", f"{r['longest_gap']} s", r["faults"]]
        for r in tabulate_mocap_bodies(session.audit, options)
    ]
    streams = [["sensor", "topic", "type", "messages", "rate", "longest gap"]]
    inferred = []
    for r in tabulate_sensor_streams(session.audit, session.frames, sensors):
        rate, gap = f"{r['rate']} Hz", f"{r['longest_gap']} s"
        streams.append([r["name"], r["topic"], r["type"], r["messages"], rate, gap])
        inferred += [f"{r['name']}: {text}" for text in r["inferred"]]
    notes = [
        f"{subject}: {text}" for subject, text in list_log_notes(session.audit, session.mocap_notes)
    ]
    return [*align_columns(bodies), "", *align_columns(streams), "", *notes, *inferred, ""]


def list_unknown_poses(preflight: dict[str, Any]) -> list[str]:
    """Return a line per sensor pose and per target mount that the config does not state."""
    sensor_notes: dict[str, None] = {}  # a set in order
    target_notes: dict[str, None] = {}
    for sensor, block in preflight["sensors"].items():
        for session, visibility in block["sessions"].items():
            for target, counts in visibility["targets"].items():
                if visibility["pose_source"] == "none":
                    sensor_notes[f"the pose of {sensor} in {session} {UNKNOWN_POSE_NOTE}"] = None
                elif counts["expected"] is None:
                    target_notes[f"the mount of {target} in its body {UNKNOWN_POSE_NOTE}"] = None
    return [*sensor_notes, *target_notes]


def format_placement_table(preflight: dict[str, Any]) -> list[str]:
    """Return a table of the visible placements by sensor, session and target."""
    rows = [["sensor", "session", "target", "still", "visible", "moving views", "not visible"]]
    for sensor, block in preflight["sensors"].items():
        for session, visibility in block["sessions"].items():
            for target, counts in visibility["targets"].items():
                lost = ", ".join(f"{n} {reason}" for reason, n in counts["not_visible"].items())
                n_still, n_moving = str(counts["placements"]), str(counts["moving_views"])
                visible = _format_count_range(counts)
                rows.append([sensor, session, target, n_still, visible, n_moving, lost])
            if not visibility["targets"]:
                reason = visibility["status"]["reason"]
                rows.append([sensor, session, *[DASH] * 4, reason])
    return align_columns(rows)


def format_sensor_table(preflight: dict[str, Any]) -> list[str]:
    """Return a table of the visible placements of each sensor, and how their directions differ."""
    rows = [["sensor", "visible", "angle between boards", "between cylinders", "moving views"]]
    for name, block in preflight["sensors"].items():
        angles = [block["direction_spread_deg"].get(k) for k in ("normals", "axes")]
        texts = [DASH if angle is None else f"{angle:.0f}°" for angle in angles]
        visible = _format_count_range(block["placements"])
        rows.append([name, visible, *texts, str(block["moving_views"])])
    return align_columns(rows)


def format_rotation_table(preflight: dict[str, Any]) -> list[str]:
    """Return a table of the rotations of each target relative to the robot."""
    rows = [["target", "new poses", "rotations about its three main axes, rms"]]
    for name, block in preflight["targets"].items():
        angles = [f"{angle:.0f}°" for angle in block["rotation_spread_deg"] or ()]
        rows.append([name, str(block["placements"]), ", ".join(angles) or DASH])
    return align_columns(rows)


def _format_count_range(counts: dict[str, int | None]) -> str:
    """Format the placements visible for sure and possibly, within the σ of the pose: `5 to 6`."""
    low, high = counts["expected"], counts["possible"]
    if low is None:
        return f"at most {high}" if high else "0"
    return str(high) if low == high else f"{low} to {high}"


def format_preflight_verdict(rig: str, preflight: dict[str, Any]) -> list[str]:
    """Return the verdict in a line, and all findings with their remedies."""
    lines = [f"{rig}: {preflight_headline(preflight)}"]
    for f in preflight["findings"]:
        lines += [f"  {f['level']}: {f['text']}", f"        {f['remedy']}"]
    return lines


def preflight_headline(preflight: dict[str, Any]) -> str:
    """Return in a line which sensors these recordings can calibrate."""
    failed = sorted(n for n, level in preflight["levels"].items() if level == "fail")
    sensors = format_plural(len(preflight["levels"]) - len(failed), "sensor")
    if preflight["verdict"] == "fail":
        return "THESE RECORDINGS CANNOT BE CALIBRATED"
    if failed:
        return f"{sensors} can be calibrated, not {', '.join(failed)}"
    return f"{sensors} can be calibrated" + (", but:" if preflight["findings"] else "")


def align_columns(rows: list[list[str]]) -> list[str]:
    """Return one line per row of cells, with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    padded = [[f"{c:{w}}" for c, w in zip(row, widths, strict=True)] for row in rows]
    return ["  ".join(row).rstrip() for row in padded]


def _indent_lines(lines: list[str]) -> list[str]:
    return [f"  {line}".rstrip() for line in lines]
