"""Logs through the readers of rosbags: what ROS 1 bags and SQLite files have in common."""

from heapq import merge

from rosbags.interfaces import MessageDefinitionFormat

from calib.io.logs.log_message import Message
from calib.io.logs.message_types import Types, full_name
from calib.io.status import InputError, in_a_line

FORMS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}
NS = 1e9


class RosbagsLog:
    """One recording in one or more files, in the order of their first messages.

    opened: [(path, open reader)]; serialisation: of a connection of a reader, cdr or ros1.
    """

    def __init__(self, opened, serialisation):
        opened = sorted(opened, key=lambda o: o[1].start_time)
        self.files = [path for path, _ in opened]
        self._readers = [reader for _, reader in opened]
        self.topics, self.faults = {}, []
        self._types = Types(str(self.files[0]))
        self._codecs = [self._register(reader, serialisation) for reader in self._readers]
        held = [r.start_time for r in self._readers if any(c.msgcount for c in r.connections)]
        self.start = min(held, default=0)

    def _register(self, reader, serialisation):
        """{id of a connection: Codec} of one file; its topics and types join the log's."""
        out = {}
        for c in reader.connections:
            # SQLite keeps in a column whatever it is given.
            if not all(isinstance(text, str) for text in (c.topic, c.msgtype, c.msgdef.data)):
                raise InputError(f"{self.files[0]}: its table of topics is damaged")
            name = full_name(c.msgtype)
            self._types.define(name, FORMS.get(c.msgdef.format), c.msgdef.data)
            kind, before = self.topics.get(c.topic, (name, 0))
            self.topics[c.topic] = (kind, before + c.msgcount)
            out[c.id] = self._types.codec(name, serialisation(c))
        return out

    def messages(self, topics, start=None, end=None):
        """Messages of the topics, by log time; start and end, ns of log time, bound them."""
        files = [self._of_file(n, set(topics), start, end) for n in range(len(self.files))]
        yield from merge(*files, key=lambda m: m.log_t)

    def _of_file(self, number, topics, start, end):
        seen, last = {}, None
        try:
            for connection, log_t, data in self._read(number, topics, start, end):
                if log_t != last:
                    seen, last = {}, int(log_t)
                topic, codec = connection.topic, self._codecs[number][connection.id]
                ordinal = seen.get(topic, 0)
                yield Message(topic, number, last, ordinal, bytes(data), codec)
                seen[topic] = ordinal + 1
        except Exception as error:  # whatever the library makes of damaged bytes
            after = 0.0 if last is None else (last - self.start) / NS
            self.faults.append(
                f"{self.files[number].name}: breaks off {after:.1f} s after the log's start "
                f"({in_a_line(error)})"
            )

    def _read(self, number, topics, start, end):
        reader = self._readers[number]
        wanted = [c for c in reader.connections if c.topic in topics]
        # To rosbags, no connection at all means every one.
        return reader.messages(wanted, start, end) if wanted else ()

    def message(self, topic, file, log_t, ordinal):
        """The content of one message, at its place in the log."""
        found = list(self._of_file(file, {topic}, log_t, log_t + 1))
        if ordinal >= len(found):
            raise InputError(f"{self.files[file]}: no message of {topic} at {log_t} any more")
        return found[ordinal].content


def opened(files, kind, remedy):
    """[(path, open reader)] of files by a class of readers; what to do about one that cannot be
    read is the remedy, with {} for the file's name."""
    out = []
    for path in files:
        reader = kind(path)
        try:
            reader.open()
            int(reader.start_time)
        except Exception as error:  # whatever the library makes of foreign bytes
            raise InputError(
                f"{path}: cannot be read ({in_a_line(error)}); {remedy.format(path.name)}"
            ) from error
        out.append((path, reader))
    return out
