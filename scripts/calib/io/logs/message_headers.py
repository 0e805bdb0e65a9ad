"""When a message of a sensor was stamped, and in which frame it is."""

NS = 1_000_000_000
HEADLESS = "foxglove_msgs/"  # types that say so themselves, not in a std_msgs/Header


def of(message):
    """What holds stamp and frame_id of a Message of a log; the rest of it is not read, where it
    begins with a std_msgs/Header."""
    return message.content if message.type.startswith(HEADLESS) else message.header


def stamp_ns(head):
    """The stamp, ns, of what `of` gives, or of a whole message."""
    head = getattr(head, "header", head)
    stamp = head.stamp if hasattr(head, "stamp") else head.timestamp
    return stamp.sec * NS + stamp.nanosec
