"""Logs through the readers of rosbags: what ROS 1 bags and SQLite files have in common."""

from heapq import merge

from rosbags.interfaces import MessageDefinitionFormat

from calib.geometry.units import NS_PER_S
from calib.io.logs.log_message import LogMessage
from calib.io.logs.message_types import MessageTypes, full_type_name
from calib.io.status import InputError, summarize_error

DEFINITION_FORMATS = {
    MessageDefinitionFormat.MSG: "ros2msg",
    MessageDefinitionFormat.IDL: "ros2idl",
}


class RosbagsLog:
    """One recording in one or more files, in the order of their first messages.

    opened: [(path, open reader)]; serialisation: of a connection of a reader, cdr or ros1.
    """

    def __init__(self, readers, serialisation):
        readers = sorted(readers, key=lambda o: o[1].start_time)
        self.files = [path for path, _ in readers]
        self._readers = [reader for _, reader in readers]
        self.topics, self.read_errors = {}, []
        self._types = MessageTypes(str(self.files[0]))
        self._codecs = [
            self._register_connections(reader, serialisation) for reader in self._readers
        ]
        held = [r.start_time for r in self._readers if any(c.msgcount for c in r.connections)]
        self.start_ns = min(held, default=0)

    def _register_connections(self, reader, serialisation):
        """{id of a connection: Codec} of one file; its topics and types join the log's."""
        out = {}
        for c in reader.connections:
            # SQLite keeps in a column whatever it is given.
            if not all(isinstance(text, str) for text in (c.topic, c.msgtype, c.msgdef.data)):
                raise InputError(f"{self.files[0]}: its table of topics is damaged")
            name = full_type_name(c.msgtype)
            self._types.add_definition(name, DEFINITION_FORMATS.get(c.msgdef.format), c.msgdef.data)
            kind, before = self.topics.get(c.topic, (name, 0))
            self.topics[c.topic] = (kind, before + c.msgcount)
            out[c.id] = self._types.make_codec(name, serialisation(c))
        return out

    def iter_messages(self, topics, start_ns=None, end_ns=None):
        """Messages of the topics, by log time; start and end, ns of log time, bound them."""
        files = [
            self._iter_file_messages(n, set(topics), start_ns, end_ns)
            for n in range(len(self.files))
        ]
        yield from merge(*files, key=lambda m: m.log_time_ns)

    def _iter_file_messages(self, number, topics, start, end):
        seen, last = {}, None
        try:
            for connection, log_t, data in self._iter_raw_messages(number, topics, start, end):
                if log_t != last:
                    seen, last = {}, int(log_t)
                topic, codec = connection.topic, self._codecs[number][connection.id]
                ordinal = seen.get(topic, 0)
                yield LogMessage(topic, number, last, ordinal, bytes(data), codec)
                seen[topic] = ordinal + 1
        except Exception as error:  # whatever the library makes of damaged bytes
            after = 0.0 if last is None else (last - self.start_ns) / NS_PER_S
            self.read_errors.append(
                f"{self.files[number].name}: breaks off {after:.1f} s after the log's start "
                f"({summarize_error(error)})"
            )

    def _iter_raw_messages(self, number, topics, start, end):
        reader = self._readers[number]
        wanted = [c for c in reader.connections if c.topic in topics]
        # To rosbags, no connection at all means every one.
        return reader.messages(wanted, start, end) if wanted else ()

    def read_message_content(self, topic, file_index, log_time_ns, index_at_log_time):
        """The content of one message, at its place in the log."""
        found = list(self._iter_file_messages(file_index, {topic}, log_time_ns, log_time_ns + 1))
        if index_at_log_time >= len(found):
            raise InputError(
                f"{self.files[file_index]}: no message of {topic} at {log_time_ns} any more"
            )
        return found[index_at_log_time].content


def open_readers(files, reader_class, remedy):
    """[(path, open reader)] of files by a class of readers; what to do about one that cannot be
    read is the remedy, with {} for the file's name."""
    out = []
    for path in files:
        reader = reader_class(path)
        try:
            reader.open()
            int(reader.start_time)
        except Exception as error:  # whatever the library makes of foreign bytes
            raise InputError(
                f"{path}: cannot be read ({summarize_error(error)}); {remedy.format(path.name)}"
            ) from error
        out.append((path, reader))
    return out
