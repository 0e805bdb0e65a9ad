"""MCAP files with ROS messages, through their index; one without its end up to where it breaks."""

from bisect import bisect_left
from collections import Counter

from calib.io.logs import mcap_index
from calib.io.logs.log_message import Message
from calib.io.logs.message_types import Types, full_name
from calib.io.status import InputError, in_a_line

WITHOUT = "without schema"


class McapLog:
    """One recording in one or more MCAP files, in the order of their first messages."""

    def __init__(self, files):
        found = sorted(
            ((mcap_index.read(path), path) for path in files),
            key=lambda f: (f[0].start is None, f[0].start),
        )
        self.files = [path for _, path in found]
        self.topics, self._damaged, self._untimely = {}, set(), set()
        self._faults = [index.fault for index, _ in found if index.fault]
        self._types = Types(str(self.files[0]))
        self._codecs = [self._register(index) for index, _ in found]
        self._pieces = sorted(
            piece._replace(file=n) for n, (index, _) in enumerate(found) for piece in index.pieces
        )
        self.start = self._pieces[0].start if self._pieces else 0
        self._opened = None, None  # number of a file, and the stream

    @property
    def faults(self):
        """What of the files could not be read, in words, as far as was met up to now."""
        counts = Counter(file for file, _ in self._damaged)
        met = [
            f"{self.files[n].name}: damaged chunks left out: {k}" for n, k in sorted(counts.items())
        ]
        if self._untimely:
            met.append(f"messages of impossible log times left out: {len(self._untimely)}")
        return self._faults + met

    def _register(self, index):
        """{channel: (topic, Codec)} of one file; its topics and types join the log's."""
        out = {}
        for number, channel in sorted(index.channels.items()):
            schema = index.schemas.get(channel.schema_id)
            name = full_name(schema.name) if schema else WITHOUT
            _, before = self.topics.get(channel.topic, (name, 0))
            self.topics[channel.topic] = (name, before + index.counts.get(number, 0))
            if schema:
                text = bytes(schema.data).decode(errors="replace")
                self._types.define(name, schema.encoding, text)
            out[number] = (channel.topic, self._types.codec(name, channel.message_encoding))
        return out

    def _wanted(self, topics):
        """Per file the channels of the topics."""
        topics = set(topics)
        return [{n for n, (topic, _) in c.items() if topic in topics} for c in self._codecs]

    def messages(self, topics, start=None, end=None):
        """Messages of the topics, by log time; start and end, ns of log time, bound them."""
        seen, last = [{} for _ in self.files], [None] * len(self.files)
        for log_t, file, _, _, record in self._in_order(self._wanted(topics), start, end):
            if log_t != last[file]:
                seen[file], last[file] = {}, log_t
            topic, codec = self._codecs[file][record.channel_id]
            ordinal = seen[file].get(topic, 0)
            yield Message(topic, file, log_t, ordinal, record.data, codec)
            seen[file][topic] = ordinal + 1

    def _in_order(self, wanted, start, end):
        """(log time, file, offset, number, record) in that order, a few pieces in memory."""
        waiting = []
        for piece in self._pieces:
            channels = wanted[piece.file]
            if not (piece.channels is None or piece.channels & channels):
                continue
            if (end is not None and piece.start >= end) or (
                start is not None and piece.end < start
            ):
                continue
            ready = bisect_left(waiting, (piece.start, piece.file, piece.offset))
            yield from waiting[:ready]
            held = self._held(piece, channels, start, end)
            waiting = sorted(waiting[ready:] + held, key=_place)
        yield from waiting

    def _held(self, piece, channels, start=None, end=None):
        """Entries of the messages of a piece; none, and a fault of the log, if it is damaged."""
        path = self.files[piece.file]
        try:
            records = mcap_index.messages(self._stream(piece.file), piece)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({in_a_line(error)})") from error
        except Exception:  # whatever the library makes of a damaged chunk
            self._damaged.add((piece.file, piece.offset))
            return []
        late = mcap_index.LATEST
        entries = [(r.log_time, piece.file, piece.offset, n, r) for n, r in enumerate(records)]
        self._untimely |= {e[1:4] for e in entries if e[0] >= late}
        first, last = start or 0, late if end is None else end
        return [e for e in entries if first <= e[0] < last and e[-1].channel_id in channels]

    def _stream(self, number):
        """A file, which stays open until another is wanted."""
        last, stream = self._opened
        if last != number:
            stream = mcap_index.File(self.files[number])
            self._opened = number, stream
        return stream

    def message(self, topic, file, log_t, ordinal):
        """The content of one message, at its place in the log."""
        channels = self._wanted([topic])[file]
        pieces = [p for p in self._pieces if p.file == file and p.start <= log_t <= p.end]
        found = [e for p in pieces for e in self._held(p, channels, log_t, log_t + 1)]
        found = sorted(found, key=_place)
        if ordinal >= len(found):
            raise InputError(f"{self.files[file]}: no message of {topic} at {log_t} any more")
        record = found[ordinal][-1]
        return self._codecs[file][record.channel_id][1].content(record.data)


def _place(entry):
    return entry[:4]
