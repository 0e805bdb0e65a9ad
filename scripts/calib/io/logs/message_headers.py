"""When a message of a sensor was stamped, and in which frame it is."""

from calib.geometry.units import NS_PER_S

FOXGLOVE_TYPE_PREFIX = "foxglove_msgs/"  # types that say so themselves, not in a std_msgs/Header


def read_message_header(message):
    """What holds stamp and frame_id of a Message of a log; the rest of it is not read, where it
    begins with a std_msgs/Header."""
    return message.content if message.type.startswith(FOXGLOVE_TYPE_PREFIX) else message.header


def header_stamp_ns(header):
    """The stamp, ns, of what `of` gives, or of a whole message."""
    header = getattr(header, "header", header)
    stamp = header.stamp if hasattr(header, "stamp") else header.timestamp
    return stamp.sec * NS_PER_S + stamp.nanosec
