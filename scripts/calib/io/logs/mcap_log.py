"""MCAP files with ROS messages, through their index; one without its end up to where it breaks."""

from bisect import bisect_left
from collections import Counter

from calib.io.logs.log_message import LogMessage
from calib.io.logs.mcap_index import (
    MAX_LOG_TIME_NS,
    BoundedFile,
    read_mcap_index,
    read_piece_messages,
)
from calib.io.logs.message_types import MessageTypes, full_type_name
from calib.io.status import InputError, summarize_error

NO_SCHEMA_TYPE = "without schema"


class McapLog:
    """One recording in one or more MCAP files, in the order of their first messages."""

    def __init__(self, files):
        found = sorted(
            ((read_mcap_index(path), path) for path in files),
            key=lambda f: (f[0].start_ns is None, f[0].start_ns),
        )
        self.files = [path for _, path in found]
        self.topics, self._damaged_pieces, self._bad_log_times = {}, set(), set()
        self._index_errors = [index.read_error for index, _ in found if index.read_error]
        self._types = MessageTypes(str(self.files[0]))
        self._codecs = [self._register_channels(index) for index, _ in found]
        self._pieces = sorted(
            piece._replace(file_index=n)
            for n, (index, _) in enumerate(found)
            for piece in index.pieces
        )
        self.start_ns = self._pieces[0].start_ns if self._pieces else 0
        self._open_file = None, None  # number of a file, and the stream

    @property
    def read_errors(self):
        """What of the files could not be read, in words, as far as was met up to now."""
        counts = Counter(file for file, _ in self._damaged_pieces)
        met = [
            f"{self.files[n].name}: damaged chunks left out: {k}" for n, k in sorted(counts.items())
        ]
        if self._bad_log_times:
            met.append(f"messages of impossible log times left out: {len(self._bad_log_times)}")
        return self._index_errors + met

    def _register_channels(self, index):
        """{channel: (topic, Codec)} of one file; its topics and types join the log's."""
        out = {}
        for number, channel in sorted(index.channels.items()):
            schema = index.schemas.get(channel.schema_id)
            name = full_type_name(schema.name) if schema else NO_SCHEMA_TYPE
            _, before = self.topics.get(channel.topic, (name, 0))
            self.topics[channel.topic] = (name, before + index.counts.get(number, 0))
            if schema:
                text = bytes(schema.data).decode(errors="replace")
                self._types.add_definition(name, schema.encoding, text)
            out[number] = (channel.topic, self._types.make_codec(name, channel.message_encoding))
        return out

    def _wanted_channels(self, topics):
        """Per file the channels of the topics."""
        topics = set(topics)
        return [{n for n, (topic, _) in c.items() if topic in topics} for c in self._codecs]

    def iter_messages(self, topics, start_ns=None, end_ns=None):
        """Messages of the topics, by log time; start and end, ns of log time, bound them."""
        seen, last = [{} for _ in self.files], [None] * len(self.files)
        for log_t, file, _, _, record in self._iter_entries(
            self._wanted_channels(topics), start_ns, end_ns
        ):
            if log_t != last[file]:
                seen[file], last[file] = {}, log_t
            topic, codec = self._codecs[file][record.channel_id]
            ordinal = seen[file].get(topic, 0)
            yield LogMessage(topic, file, log_t, ordinal, record.data, codec)
            seen[file][topic] = ordinal + 1

    def _iter_entries(self, wanted, start, end):
        """(log time, file, offset, number, record) in that order, a few pieces in memory."""
        waiting = []
        for piece in self._pieces:
            channels = wanted[piece.file_index]
            if not (piece.channels is None or piece.channels & channels):
                continue
            if (end is not None and piece.start_ns >= end) or (
                start is not None and piece.end_ns < start
            ):
                continue
            ready = bisect_left(waiting, (piece.start_ns, piece.file_index, piece.byte_offset))
            yield from waiting[:ready]
            held = self._read_entries(piece, channels, start, end)
            waiting = sorted(waiting[ready:] + held, key=_entry_order)
        yield from waiting

    def _read_entries(self, piece, channels, start=None, end=None):
        """Entries of the messages of a piece; none, and a fault of the log, if it is damaged."""
        path = self.files[piece.file_index]
        try:
            records = read_piece_messages(self._open_stream(piece.file_index), piece)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({summarize_error(error)})") from error
        except Exception:  # whatever the library makes of a damaged chunk
            self._damaged_pieces.add((piece.file_index, piece.byte_offset))
            return []
        late = MAX_LOG_TIME_NS
        entries = [
            (r.log_time, piece.file_index, piece.byte_offset, n, r) for n, r in enumerate(records)
        ]
        self._bad_log_times |= {e[1:4] for e in entries if e[0] >= late}
        first, last = start or 0, late if end is None else end
        return [e for e in entries if first <= e[0] < last and e[-1].channel_id in channels]

    def _open_stream(self, number):
        """A file, which stays open until another is wanted."""
        last, stream = self._open_file
        if last != number:
            stream = BoundedFile(self.files[number])
            self._open_file = number, stream
        return stream

    def read_message_content(self, topic, file_index, log_time_ns, index_at_log_time):
        """The content of one message, at its place in the log."""
        channels = self._wanted_channels([topic])[file_index]
        pieces = [
            p
            for p in self._pieces
            if p.file_index == file_index and p.start_ns <= log_time_ns <= p.end_ns
        ]
        found = [
            e for p in pieces for e in self._read_entries(p, channels, log_time_ns, log_time_ns + 1)
        ]
        found = sorted(found, key=_entry_order)
        if index_at_log_time >= len(found):
            raise InputError(
                f"{self.files[file_index]}: no message of {topic} at {log_time_ns} any more"
            )
        record = found[index_at_log_time][-1]
        return self._codecs[file_index][record.channel_id][1].decode(record.data)


def _entry_order(entry):
    return entry[:4]
