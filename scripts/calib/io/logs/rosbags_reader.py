"""Logs read with the rosbags library: common part of ROS 1 bags and SQLite files."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from heapq import merge
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeAlias

from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, MessageDefinitionFormat

from calib.geometry.units import NS_PER_S
from calib.io.logs.log_message import LogMessage, TopicInfo, missing_message_error
from calib.io.logs.message_types import MessageCodec, MessageTypes, full_type_name
from calib.io.safe_names import NameGate, safe_name
from calib.io.status import InputError, summarize_error

DEFINITION_FORMATS = {
    MessageDefinitionFormat.MSG: "ros2msg",
    MessageDefinitionFormat.IDL: "ros2idl",
}


RosbagsReader: TypeAlias = rosbag1.Reader | rosbag2.Reader


class OpenFile(NamedTuple):
    """A file and its open reader."""

    path: Path
    reader: RosbagsReader


class RosbagsLog:
    """A recording in one or more files, in the order of their first messages."""

    def __init__(
        self, opened: list[OpenFile], find_serialisation: Callable[[Connection], str]
    ) -> None:
        """find_serialisation: returns cdr or ros1 for a connection."""
        opened = sorted(opened, key=lambda o: o.reader.start_time)
        self.files = [path for path, _ in opened]
        self._readers = [reader for _, reader in opened]
        self.topics: dict[str, TopicInfo] = {}
        self.names = NameGate()
        self.temporary_folder: TemporaryDirectory[str] | None = None
        self.read_errors: list[str] = []
        self._types = MessageTypes(str(self.files[0]))
        self._codecs = [
            self._register_connections(reader, find_serialisation) for reader in self._readers
        ]
        not_empty = [r for r in self._readers if any(c.msgcount for c in r.connections)]
        self.start_ns = min((r.start_time for r in not_empty), default=0)

    def _register_connections(
        self, reader: RosbagsReader, find_serialisation: Callable[[Connection], str]
    ) -> dict[int, MessageCodec]:
        """Return the codecs of a file by connection id, and add its topics and types to the log."""
        out = {}
        for c in reader.connections:
            # A column of SQLite may hold values of any type.
            if not all(isinstance(text, str) for text in (c.topic, c.msgtype, c.msgdef.data)):
                raise InputError(
                    f"{self.files[0]}: its table of topics is damaged. Record it again."
                )
            topic, name = map(self.names.admit, (c.topic, full_type_name(c.msgtype)))
            self._types.add_definition(name, DEFINITION_FORMATS.get(c.msgdef.format), c.msgdef.data)
            earlier = self.topics.get(topic, TopicInfo(name, 0))
            self.topics[topic] = TopicInfo(earlier.type, earlier.n_messages + c.msgcount)
            out[c.id] = self._types.make_codec(name, find_serialisation(c))
        return out

    def iter_messages(
        self, topics: Iterable[str], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[LogMessage]:
        """Yield the messages of the topics with start_ns <= log time < end_ns, by log time."""
        files = [
            self._iter_file_messages(n, set(topics), start_ns, end_ns)
            for n in range(len(self.files))
        ]
        yield from merge(*files, key=lambda m: m.log_time_ns)

    def _iter_file_messages(
        self, file_index: int, topics: set[str], start_ns: int | None, end_ns: int | None
    ) -> Iterator[LogMessage]:
        counts: Counter[str] = Counter()  # messages by topic at the last log time
        last_ns: int | None = None
        try:
            raw_messages = self._iter_raw_messages(file_index, topics, start_ns, end_ns)
            for connection, log_time_ns, data in raw_messages:
                if log_time_ns != last_ns:
                    counts, last_ns = Counter(), int(log_time_ns)
                topic = safe_name(connection.topic)
                yield LogMessage(
                    topic=topic,
                    file_index=file_index,
                    log_time_ns=last_ns,
                    index_at_log_time=counts[topic],
                    data=bytes(data),
                    codec=self._codecs[file_index][connection.id],
                )
                counts[topic] += 1
        except MemoryError:
            raise
        except Exception as error:  # the library raises any type for damaged bytes
            read_s = 0.0 if last_ns is None else (last_ns - self.start_ns) / NS_PER_S
            self.read_errors.append(
                f"{self.files[file_index].name}: breaks off {read_s:.1f} s after the log's start "
                f"({summarize_error(error)})"
            )

    def _iter_raw_messages(
        self, file_index: int, topics: set[str], start_ns: int | None, end_ns: int | None
    ) -> Iterable[tuple[Connection, int, bytes]]:
        reader = self._readers[file_index]
        wanted = [c for c in reader.connections if safe_name(c.topic) in topics]
        # rosbags takes an empty list as all connections.
        return reader.messages(wanted, start_ns, end_ns) if wanted else ()

    def read_message_content(
        self, topic: str, file_index: int, log_time_ns: int, index_at_log_time: int
    ) -> Any:
        """Return the content of one message, found by its place in the log."""
        messages = list(self._iter_file_messages(file_index, {topic}, log_time_ns, log_time_ns + 1))
        if index_at_log_time >= len(messages):
            raise missing_message_error(self.files[file_index], topic, log_time_ns)
        return messages[index_at_log_time].content


def open_readers(
    files: list[Path], reader_class: Callable[[Path], RosbagsReader], remedy: str
) -> list[OpenFile]:
    """Open files with a reader class of rosbags.

    remedy: what to do about an unreadable file, with {} for its name.
    """
    out = []
    for path in files:
        reader = reader_class(path)
        try:
            reader.open()
            int(reader.start_time)
        except Exception as error:  # the library raises any type for foreign bytes
            raise InputError(
                f"{path}: cannot be read ({summarize_error(error)}). {remedy.format(path.name)}"
            ) from error
        out.append(OpenFile(path, reader))
    return out
