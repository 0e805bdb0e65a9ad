"""A message of a log, the same for all containers."""

from pathlib import Path
from typing import Any, NamedTuple

from calib.io.logs.message_types import MessageCodec
from calib.io.status import InputError


class TopicInfo(NamedTuple):
    """Message type (package/msg/Type) of a topic, and its number of messages."""

    type: str
    n_messages: int


class LogMessage(NamedTuple):
    """A message: its place in the log, its bytes and its type; decoded on demand.

    index_at_log_time: number among the messages of its topic, file and log time.
    """

    topic: str
    file_index: int
    log_time_ns: int
    index_at_log_time: int
    data: bytes
    codec: MessageCodec

    @property
    def type(self) -> str:
        """Return the type as package/msg/Type."""
        return self.codec.type

    @property
    def content(self) -> Any:
        """Return the decoded message; raises InputError if it does not fit its definition."""
        return self.codec.decode(self.data)

    @property
    def header(self) -> Any:
        """Return the std_msgs/Header alone, the first field of most sensor messages."""
        return self.codec.decode_header(self.data)


def missing_message_error(path: Path, topic: str, log_time_ns: int) -> InputError:
    """Return the error of a message that was in the log when it was decoded."""
    return InputError(f"{path}: no message of {topic} at {log_time_ns} ns any more")
