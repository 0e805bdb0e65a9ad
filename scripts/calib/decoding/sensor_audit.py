"""What the audit of a log says of one sensor."""

from fnmatch import fnmatchcase

import numpy as np

from calib.decoding.decoded_log import median_rate_hz
from calib.decoding.sensor_probe import PROBE_BY_KIND
from calib.geometry.units import NS_PER_S
from calib.io.status import OK, did_you_mean, failure_status


def audit_sensor(name, recording, topics, columns, clocks):
    """Count, rate, frame and clock of one sensor, what its messages tell (hearing), and a status;
    topics: of the log, with types."""
    sensor, heard = recording.sensors[name], recording.probes[name]
    t = np.asarray(columns["stamp_ns"])[np.asarray(columns["sensor"]) == name]
    status, hz = (
        _topic_status(sensor, topics, len(t), recording.first_errors.get(sensor["topic"])),
        median_rate_hz(t),
    )
    told = {}
    if status.ok:
        told, status = heard.audit(NS_PER_S / hz if hz else 0, topics)
    audit = told | {
        "status": status.to_dict(),
        "frame": recording.frame_ids.get(name, ""),
        "messages": len(t),
        "unreadable": recording.n_unreadable[sensor["topic"]],
        "rate_hz": hz,
    }
    return audit | (clocks[name].to_dict() if name in clocks else {})


def _topic_status(sensor, topics, messages, first_error):
    """Ok, or why a sensor's topic gives nothing; first_error: the fault of its first unreadable message."""
    topic, kind = sensor["topic"], PROBE_BY_KIND[sensor["kind"]]
    if topic not in topics:
        return missing_topic_status(topic, topics, "Check the sensor's `topic`.")
    if topics[topic][0] not in kind.message_types:
        return _wrong_type_status(sensor, kind, topics[topic][0])
    if messages == 0 and first_error:
        return failure_status(f"no message of topic {topic} can be read", first_error)
    if messages == 0:
        return failure_status(
            f"topic {topic} has no message", "0", "1 or more", "Check from_s and to_s."
        )
    return OK


def describe_unreadable_messages(recording):
    """In words, which topics had messages that could not be read, and the first one's fault."""
    return [
        f"{n} messages of {topic} could not be read and were left out: {recording.first_errors[topic]}"
        for topic, n in sorted(recording.n_unreadable.items())
    ]


def missing_topic_status(topic, topics, remedy):
    """The status of a topic that is not in the log, with the nearest that is."""
    found = ", ".join(sorted(topics)) or "no topic at all"
    return failure_status(
        f"topic {topic} is not in the log", found, topic, did_you_mean(topic, topics) or remedy
    )


def _wrong_type_status(sensor, probe, found_type):
    """Why a type is not read, with what to do where it is known."""
    known = [
        remedy
        for pattern, remedy in probe.refused_types.items()
        if fnmatchcase(found_type, pattern)
    ]
    return failure_status(
        f"topic {sensor['topic']} carries another type",
        found_type,
        " or ".join(probe.types),
        known[0] if known else f"Name the {sensor['kind']}'s topic, or record it in that type.",
    )
