"""When a message of a sensor was stamped, and in which frame it is."""

NS = 1_000_000_000


def stamp_ns(message):
    """The stamp, ns, of a ROS message with a header, or of a Foxglove one, which has none."""
    stamp = _head(message).timestamp if _headless(message) else message.header.stamp
    return stamp.sec * NS + stamp.nanosec


def frame_id(message):
    """The frame in which a message says that its sensor measured."""
    return _head(message).frame_id


def _headless(message):
    return not hasattr(message, "header")


def _head(message):
    return message if _headless(message) else message.header
