"""Stamp and frame of a message."""

from typing import Any

from calib.geometry.units import NS_PER_S
from calib.io.logs.log_message import LogMessage

FOXGLOVE_TYPE_PREFIX = (
    "foxglove_msgs/"  # these types have their own stamp fields, no std_msgs/Header
)


def read_message_header(message: LogMessage) -> Any:
    """Return the part of a message that holds stamp and frame_id.

    A std_msgs/Header is read alone, without the rest of the message.
    """
    return message.content if message.type.startswith(FOXGLOVE_TYPE_PREFIX) else message.header


def header_stamp_ns(header: Any) -> int:
    """Return the stamp, ns, of a header or of a whole message; 0 if it was never set."""
    header = getattr(header, "header", header)
    stamp = header.stamp if hasattr(header, "stamp") else header.timestamp
    return stamp.sec * NS_PER_S + stamp.nanosec
