"""The preflight of a rig as lines for the terminal; what it concludes comes last."""

from dataclasses import dataclass

from calib.report import number_format
from calib.report.sections import recording_audit

UNSTATED = "is not stated: it is looked for in the data, and until then all counts as seen"


@dataclass(frozen=True)
class Told:
    """What report.intake reads of a run: options with sensors, targets and body; looks.Session by
    name."""

    options: dict
    sessions: dict


def lines(rig, judged, told):
    """Lines on the sessions of a rig, what its sensors see, and what follows; judged: the content
    of preflight.json."""
    out = [line for session in told.sessions for line in of_session(rig, session, told)]
    out += [
        f"{rig}: placements that each sensor sees, by its stated pose and its field of view",
        *_indented(placements(judged)),
        "",
    ]
    notes = unstated(judged)
    out += _indented([*notes, *([""] if notes else []), *sensors(judged), "", *turning(judged)])
    return [*out, "", *conclusion(rig, judged)]


def unstated(judged):
    """Lines on the poses of sensors and the mounts of targets that nobody has told."""
    sensors, targets = {}, {}
    for sensor, about in judged["sensors"].items():
        for session, s in about["sessions"].items():
            for target, n in s["targets"].items():
                if s["pose_from"] == "none":
                    sensors[f"the pose of {sensor} in {session} {UNSTATED}"] = None
                elif n["expected"] is None:
                    targets[f"where {target} sits in its body {UNSTATED}"] = None
    return [*sensors, *targets]


def of_session(rig, session, told):
    """Lines on what a log holds and what is wrong with it."""
    bodies = [
        [r["name"], r["role"], r["poses"], f"{r['rate']} Hz", f"{r['gap']} s", r["faults"]]
        for r in recording_audit.bodies(told, session)
    ]
    streams = [
        [r["name"], r["topic"], r["type"], r["messages"], f"{r['rate']} Hz", f"{r['gap']} s"]
        for r in recording_audit.streams(told, session)
    ]
    told_of = [
        f"{row['name']}: {words}"
        for row in recording_audit.streams(told, session)
        for words in row["told"]
    ]
    heard = [f"{what}: {words}" for what, words in recording_audit.heard(told, session)]
    head = ["motion capture", "", "poses", "rate", "longest gap", "faults"]
    below = ["sensor", "topic", "type", "messages", "rate", "longest gap"]
    tables = [*aligned([head, *bodies]), "", *aligned([below, *streams]), ""]
    return [f"{rig}, session {session}", *_indented([*tables, *heard, *told_of, ""])]


def placements(judged):
    """A table of preflight.json: sensor by session and target."""
    rows = [["sensor", "session", "target", "still", "seen", "in motion", "not seen"]]
    for sensor, about in judged["sensors"].items():
        for session, s in about["sessions"].items():
            for target, n in s["targets"].items():
                lost = ", ".join(f"{k} {why}" for why, k in n["lost"].items())
                counts = [str(n["placements"]), _between(n), str(n["views_in_motion"])]
                rows.append([sensor, session, target, *counts, lost])
            if not s["targets"]:
                rows.append([sensor, session, *[number_format.DASH] * 4, s["status"]["reason"]])
    return aligned(rows)


def sensors(judged):
    """A table of how much each sensor sees in all, and how it differs."""
    rows = [["sensor", "seen", "boards' normals differ by", "cylinders' axes", "views in motion"]]
    for name, about in judged["sensors"].items():
        wide = [about["tilt_deg"].get(k) for k in ("normals", "axes")]
        wide = [number_format.DASH if w is None else f"{w:.0f}°" for w in wide]
        rows.append([name, _between(about["placements"]), *wide, str(about["views_in_motion"])])
    return aligned(rows)


def turning(judged):
    """A table of how each target turns in front of the robot."""
    rows = [["target", "still", "turns about its three main axes, rms"]]
    for name, about in judged["targets"].items():
        turned = [f"{angle:.0f}°" for angle in about["turns_deg"] or ()]
        rows.append([name, str(about["placements"]), ", ".join(turned) or number_format.DASH])
    return aligned(rows)


def _between(n):
    """`5 to 6`: as the pose is stated, and wherever within its uncertainty it is."""
    low, high = n["expected"], n["possible"]
    if low is None:
        return f"at most {high}" if high else "0"
    return str(high) if low == high else f"{low} to {high}"


def conclusion(rig, judged):
    """The verdict in a line, and every finding with what to do, the gravest first."""
    told = [f"{rig}: {headline(judged)}"]
    for f in judged["findings"]:
        told += [f"  {f['level']}: {f['text']}", f"        {f['remedy']}"]
    return told


def headline(judged):
    """What the recordings support, in a line."""
    failed = sorted(n for n, level in judged["levels"].items() if level == "fail")
    good = number_format.plural(len(judged["levels"]) - len(failed), "sensor")
    if judged["verdict"] == "fail":
        return "THESE RECORDINGS CANNOT BE CALIBRATED"
    if failed:
        return f"{good} can be calibrated, not {', '.join(failed)}"
    return f"{good} can be calibrated" + (", but:" if judged["findings"] else "")


def aligned(rows):
    """Lines of rows of cells, in columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    padded = [[f"{c:{w}}" for c, w in zip(row, widths, strict=True)] for row in rows]
    return ["  ".join(row).rstrip() for row in padded]


def _indented(told):
    return [f"  {line}".rstrip() for line in told]
