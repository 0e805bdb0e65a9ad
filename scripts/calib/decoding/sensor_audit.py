"""Audit of one sensor in a log."""

from collections.abc import Collection
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from calib.decoding.decoded_log import DecodedLog, median_rate_hz
from calib.decoding.sensor_probe import PROBE_BY_KIND, SensorProbe
from calib.decoding.stream_clocks import StreamClock
from calib.geometry.units import NS_PER_S
from calib.io.logs.log_message import TopicInfo
from calib.io.parquet_tables import Columns
from calib.io.status import OK, Status, did_you_mean, failure_status


def audit_sensor(
    name: str,
    decoded: DecodedLog,
    topics: dict[str, TopicInfo],
    columns: Columns,
    clocks: dict[str, StreamClock],
) -> dict[str, Any]:
    """Return the block of a sensor in log.json: counts, rate, frame, clock, probe and status.

    topics: of the log; columns: of frames.parquet.
    """
    sensor = decoded.sensors[name]
    t = np.asarray(columns["stamp_ns"])[np.asarray(columns["sensor"]) == name]
    rate_hz = median_rate_hz(t)
    status = _topic_status(sensor, topics, len(t), decoded.first_errors.get(sensor["topic"]))
    probed: dict[str, Any] = {}
    if status.ok:
        period_ns = NS_PER_S / rate_hz if rate_hz else 0
        probed, status = decoded.probes[name].audit(period_ns, topics)
    audit = probed | {
        "status": status.to_dict(),
        "frame": decoded.frame_ids.get(name, ""),
        "messages": len(t),
        "unreadable": decoded.n_unreadable[sensor["topic"]],
        "rate_hz": rate_hz,
    }
    return audit | (clocks[name].to_dict() if name in clocks else {})


def _topic_status(
    sensor: dict[str, Any], topics: dict[str, TopicInfo], n_messages: int, first_error: str | None
) -> Status:
    """Return ok, or why a sensor's topic has no usable message.

    first_error: why its first unreadable message is unreadable.
    """
    topic, probe = sensor["topic"], PROBE_BY_KIND[sensor["kind"]]
    if topic not in topics:
        return missing_topic_status(topic, topics, "Check the sensor's `topic`.")
    found_type = TopicInfo(*topics[topic]).type
    if found_type not in probe.message_types:
        return _wrong_type_status(sensor, probe, found_type)
    if n_messages == 0 and first_error:
        return failure_status(f"no message of topic {topic} can be read", first_error)
    if n_messages == 0:
        return failure_status(
            f"topic {topic} has no message", "0", "1 or more", "Check from_s and to_s."
        )
    return OK


def describe_unreadable_messages(decoded: DecodedLog) -> list[str]:
    """Return a line per topic with unreadable messages: their number and the first error."""
    return [
        f"{n} messages of {topic} could not be read and are left out: {decoded.first_errors[topic]}"
        for topic, n in sorted(decoded.n_unreadable.items())
    ]


def missing_topic_status(topic: str, topics: Collection[str], remedy: str) -> Status:
    """Return the status of a topic that is not in the log, with the nearest one as a suggestion."""
    found = ", ".join(sorted(topics)) or "no topic"
    return failure_status(
        f"topic {topic} is not in the log", found, topic, did_you_mean(topic, topics) or remedy
    )


def _wrong_type_status(sensor: dict[str, Any], probe: type[SensorProbe], found_type: str) -> Status:
    """Return the status of a topic whose type is not read, with a remedy for known types."""
    remedies = [
        remedy
        for pattern, remedy in probe.refused_types.items()
        if fnmatchcase(found_type, pattern)
    ]
    default = f"Set `topic` to a topic of the {sensor['kind']}, or record it in one of these types."
    return failure_status(
        f"topic {sensor['topic']} carries another type",
        found_type,
        " or ".join(probe.message_types),
        remedies[0] if remedies else default,
    )
