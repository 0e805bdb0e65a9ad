"""The preflight of a rig as lines for the terminal; what it concludes comes last."""

from dataclasses import dataclass

from calib.report.number_format import DASH, format_plural
from calib.report.sections.recording_audit import (
    list_log_notes,
    tabulate_mocap_bodies,
    tabulate_sensor_streams,
)

UNKNOWN_POSE_TEXT = "is not stated: it is looked for in the data, and until then all counts as seen"


@dataclass(frozen=True)
class PreflightRun:
    """What report.intake reads of a run: options with sensors, targets and body; looks.Session by
    name."""

    options: dict
    sessions: dict


def format_preflight(rig, preflight, run):
    """Lines on the sessions of a rig, what its sensors see, and what follows; preflight: the content
    of preflight.json."""
    out = [line for session in run.sessions for line in format_session_audit(rig, session, run)]
    out += [
        f"{rig}: placements that each sensor sees, by its stated pose and its field of view",
        *_indent_lines(format_placement_table(preflight)),
        "",
    ]
    notes = list_unknown_poses(preflight)
    out += _indent_lines(
        [
            *notes,
            *([""] if notes else []),
            *format_sensor_table(preflight),
            "",
            *format_turn_table(preflight),
        ]
    )
    return [*out, "", *format_preflight_verdict(rig, preflight)]


def list_unknown_poses(preflight):
    """Lines on the poses of sensors and the mounts of targets that nobody has told."""
    sensors, targets = {}, {}
    for sensor, about in preflight["sensors"].items():
        for session, s in about["sessions"].items():
            for target, n in s["targets"].items():
                if s["pose_source"] == "none":
                    sensors[f"the pose of {sensor} in {session} {UNKNOWN_POSE_TEXT}"] = None
                elif n["expected"] is None:
                    targets[f"where {target} sits in its body {UNKNOWN_POSE_TEXT}"] = None
    return [*sensors, *targets]


def format_session_audit(rig, session, run):
    """Lines on what a log holds and what is wrong with it."""
    bodies = [
        [r["name"], r["role"], r["poses"], f"{r['rate']} Hz", f"{r['gap']} s", r["faults"]]
        for r in tabulate_mocap_bodies(run, session)
    ]
    streams = [
        [r["name"], r["topic"], r["type"], r["messages"], f"{r['rate']} Hz", f"{r['gap']} s"]
        for r in tabulate_sensor_streams(run, session)
    ]
    told_of = [
        f"{row['name']}: {words}"
        for row in tabulate_sensor_streams(run, session)
        for words in row["told"]
    ]
    heard = [f"{what}: {words}" for what, words in list_log_notes(run, session)]
    head = ["motion capture", "", "poses", "rate", "longest gap", "faults"]
    below = ["sensor", "topic", "type", "messages", "rate", "longest gap"]
    tables = [*align_columns([head, *bodies]), "", *align_columns([below, *streams]), ""]
    return [f"{rig}, session {session}", *_indent_lines([*tables, *heard, *told_of, ""])]


def format_placement_table(preflight):
    """A table of preflight.json: sensor by session and target."""
    rows = [["sensor", "session", "target", "still", "seen", "in motion", "not seen"]]
    for sensor, about in preflight["sensors"].items():
        for session, s in about["sessions"].items():
            for target, n in s["targets"].items():
                lost = ", ".join(f"{k} {why}" for why, k in n["not_visible"].items())
                counts = [str(n["placements"]), _format_count_range(n), str(n["moving_views"])]
                rows.append([sensor, session, target, *counts, lost])
            if not s["targets"]:
                rows.append([sensor, session, *[DASH] * 4, s["status"]["reason"]])
    return align_columns(rows)


def format_sensor_table(preflight):
    """A table of how much each sensor sees in all, and how it differs."""
    rows = [["sensor", "seen", "boards' normals differ by", "cylinders' axes", "views in motion"]]
    for name, about in preflight["sensors"].items():
        wide = [about["direction_spread_deg"].get(k) for k in ("normals", "axes")]
        wide = [DASH if w is None else f"{w:.0f}°" for w in wide]
        rows.append(
            [name, _format_count_range(about["placements"]), *wide, str(about["moving_views"])]
        )
    return align_columns(rows)


def format_turn_table(preflight):
    """A table of how each target turns in front of the robot."""
    rows = [["target", "still", "turns about its three main axes, rms"]]
    for name, about in preflight["targets"].items():
        turned = [f"{angle:.0f}°" for angle in about["rotation_spread_deg"] or ()]
        rows.append([name, str(about["placements"]), ", ".join(turned) or DASH])
    return align_columns(rows)


def _format_count_range(counts):
    """`5 to 6`: as the pose is stated, and wherever within its uncertainty it is."""
    low, high = counts["expected"], counts["possible"]
    if low is None:
        return f"at most {high}" if high else "0"
    return str(high) if low == high else f"{low} to {high}"


def format_preflight_verdict(rig, preflight):
    """The verdict in a line, and every finding with what to do, the gravest first."""
    told = [f"{rig}: {preflight_headline(preflight)}"]
    for f in preflight["findings"]:
        told += [f"  {f['level']}: {f['text']}", f"        {f['remedy']}"]
    return told


def preflight_headline(preflight):
    """What the recordings support, in a line."""
    failed = sorted(n for n, level in preflight["levels"].items() if level == "fail")
    good = format_plural(len(preflight["levels"]) - len(failed), "sensor")
    if preflight["verdict"] == "fail":
        return "THESE RECORDINGS CANNOT BE CALIBRATED"
    if failed:
        return f"{good} can be calibrated, not {', '.join(failed)}"
    return f"{good} can be calibrated" + (", but:" if preflight["findings"] else "")


def align_columns(rows):
    """Lines of rows of cells, in columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    padded = [[f"{c:{w}}" for c, w in zip(row, widths, strict=True)] for row in rows]
    return ["  ".join(row).rstrip() for row in padded]


def _indent_lines(lines):
    return [f"  {line}".rstrip() for line in lines]
