"""What the audit of a log says of one sensor."""

import difflib
from fnmatch import fnmatchcase

import numpy as np

from calib.decoding import decoded_log, sensor_probe
from calib.decoding.decoded_log import NS
from calib.io.status import OK, failed


def sensor_audit(name, recording, topics, columns, clocks):
    """Count, rate, frame and clock of one sensor, what its messages tell (hearing), and a status;
    topics: of the log, with types."""
    sensor, heard = recording.sensors[name], recording.heard[name]
    t = np.asarray(columns["t"])[np.asarray(columns["sensor"]) == name]
    status, hz = (
        _heard(sensor, topics, len(t), recording.why.get(sensor["topic"])),
        decoded_log.rate(t),
    )
    told = {}
    if status.ok:
        told, status = heard.told(NS / hz if hz else 0, topics)
    audit = told | {
        "status": status.to_dict(),
        "frame": recording.frame_ids.get(name, ""),
        "messages": len(t),
        "unreadable": recording.unreadable[sensor["topic"]],
        "rate_hz": hz,
    }
    return audit | (clocks[name].to_dict() if name in clocks else {})


def _heard(sensor, topics, messages, why):
    """Ok, or why a sensor's topic gives nothing; why: the fault of its first unreadable message."""
    topic, kind = sensor["topic"], sensor_probe.KINDS[sensor["kind"]]
    if topic not in topics:
        return missing(topic, topics, "check the sensor's `topic`")
    if topics[topic][0] not in kind.types:
        return _another_type(sensor, kind, topics[topic][0])
    if messages == 0 and why:
        return failed(f"no message of topic {topic} can be read", why)
    if messages == 0:
        return failed(f"topic {topic} has no message", "0", "1 or more", "Check from_s and to_s.")
    return OK


def unread(recording):
    """In words, which topics had messages that could not be read, and the first one's fault."""
    return [
        f"{n} messages of {topic} could not be read and were left out: {recording.why[topic]}"
        for topic, n in sorted(recording.unreadable.items())
    ]


def missing(topic, topics, remedy):
    """The status of a topic that is not in the log, with the nearest that is."""
    near = difflib.get_close_matches(topic, topics, 1)
    found = ", ".join(sorted(topics)) or "no topic at all"
    remedy = f"did you mean {near[0]}?" if near else remedy
    return failed(f"topic {topic} is not in the log", found, topic, remedy)


def _another_type(sensor, kind, found):
    """Why a type is not read, with what to do where it is known."""
    known = [remedy for pattern, remedy in kind.refused.items() if fnmatchcase(found, pattern)]
    return failed(
        f"topic {sensor['topic']} carries another type",
        found,
        " or ".join(kind.types),
        known[0] if known else f"Name the {sensor['kind']}'s topic, or record it in that type.",
    )
