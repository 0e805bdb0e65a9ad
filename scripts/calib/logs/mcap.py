"""MCAP files with ROS 2 messages, read through their index; types come from the log itself."""

import os
import struct
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from calib.status import InputError

# What the reader raises on a damaged file; a RuntimeError is LZ4's.
BROKEN = (McapError, zstandard.ZstdError, RuntimeError, OSError, struct.error)


@dataclass(frozen=True)
class Message:
    """One message: where it stands in the log, and what it says (`content`, on demand)."""

    topic: str
    file: int
    log_t: int
    ordinal: int
    data: bytes
    type: str
    decode: object

    @cached_property
    def content(self):
        return self.decode(self.data, self.type)


class McapLog:
    """One recording in one or more MCAP files, in the order of their first messages."""

    def __init__(self, files):
        self._store = get_typestore(Stores.EMPTY)
        self._known, self._definitions = set(), {}
        self.topics = {}
        starts = {}
        for path in files:
            with _reader(path) as reader:
                summary = reader.get_summary()
            if summary is None or summary.statistics is None:
                raise InputError(_without_index(path))
            starts[path] = summary.statistics.message_start_time
            self._register(summary)
        self.files = sorted(files, key=starts.get)
        self.start = min(starts.values())

    def _register(self, summary):
        counts = summary.statistics.channel_message_counts
        for number, channel in sorted(summary.channels.items()):
            schema = summary.schemas.get(channel.schema_id)
            name = _full_name(schema)
            before = self.topics.get(channel.topic, (name, 0))[1]
            self.topics[channel.topic] = (name, before + counts.get(number, 0))
            if schema and schema.encoding == "ros2msg":
                self._definitions.setdefault(name, schema.data.decode())

    def _decode(self, data, name):
        # A definition is read when it is needed: those of service events are none of messages.
        if name not in self._known:
            if name not in self._definitions:
                raise InputError(
                    f"{self.files[0]}: holds {name} without its .msg definition; "
                    "record it with `ros2 bag record` and the storage mcap"
                )
            types = get_types_from_msg(self._definitions[name], name)
            self._store.register({k: v for k, v in types.items() if k not in self._known})
            self._known.update(types)
        return self._store.deserialize_cdr(data, name)

    def messages(self, topics, start=None, end=None):
        """Messages of the topics, by log time; start and end, ns of log time, bound them."""
        for number, path in enumerate(self.files):
            seen, last = Counter(), None
            with _reader(path) as reader:
                found = reader.iter_messages(
                    topics=list(topics), starting_at=start, ending_before=end
                )
                for schema, channel, message in found:
                    if message.log_time != last:
                        seen, last = Counter(), message.log_time
                    yield Message(
                        channel.topic,
                        number,
                        message.log_time,
                        seen[channel.topic],
                        message.data,
                        _full_name(schema),
                        self._decode,
                    )
                    seen[channel.topic] += 1

    def message(self, topic, file, log_t, ordinal):
        """The content of one message, at its place in the log."""
        with _reader(self.files[file]) as reader:
            found = reader.iter_messages(topics=[topic], starting_at=log_t, ending_at=log_t)
            for number, (schema, _, message) in enumerate(found):
                if number == ordinal:
                    return self._decode(message.data, _full_name(schema))
        raise InputError(f"{self.files[file]}: no message of {topic} at {log_t} any more")


def _full_name(schema):
    """package/msg/Type, also of a schema named package/Type."""
    if schema is None:
        return "without schema"
    parts = schema.name.split("/")
    return "/".join([parts[0], "msg", parts[-1]])


def _without_index(path):
    return (
        f"{path}: has no index, as when the recorder was stopped hard; "
        f"run `mcap recover {path.name}` and use its output"
    )


def _cut_short(path):
    """Whether a file begins as an MCAP but does not end as one."""
    if not path.is_file() or path.stat().st_size < 2 * len(MCAP0_MAGIC):
        return False
    with path.open("rb") as stream:
        begin = stream.read(len(MCAP0_MAGIC))
        stream.seek(-len(MCAP0_MAGIC), os.SEEK_END)
        return begin == MCAP0_MAGIC != stream.read()


@contextmanager
def _reader(path):
    try:
        with path.open("rb") as stream:
            yield make_reader(stream)
    except BROKEN as error:
        raise InputError(
            _without_index(path)
            if _cut_short(path)
            else f"{path}: not a readable MCAP file ({type(error).__name__}: {error}); "
            f"run `mcap doctor {path.name}`"
        ) from error
