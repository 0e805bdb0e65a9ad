"""One message of a log, whatever holds it."""

from typing import NamedTuple

from calib.io.logs.message_types import MessageCodec


class LogMessage(NamedTuple):
    """Where a message stands in its log, its type, its bytes; what it says, on demand.

    ordinal: its number among the topic's messages of that file and log time, ns.
    """

    topic: str
    file_index: int
    log_time_ns: int
    index_at_log_time: int
    data: bytes
    codec: MessageCodec

    @property
    def type(self):
        """package/msg/Type."""
        return self.codec.type

    @property
    def content(self):
        """The whole message; raises InputError where it does not fit its definition."""
        return self.codec.decode(self.data)

    @property
    def header(self):
        """Its std_msgs/Header alone, which comes first in every type of a sensor; like content."""
        return self.codec.decode_header(self.data)
