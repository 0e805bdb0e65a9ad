"""Where the messages of an MCAP file stand: from its index, else from reading it end to end."""

import io
from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader

from calib.io.logs import decompression
from calib.io.status import InputError, in_a_line

LATEST = 1 << 62  # ns; a log time beyond is a wrong bit
LOOSE = 1 << 20  # bytes of messages outside of chunks that are read at a time
NS = 1e9


class Piece(NamedTuple):
    """A part of a file that holds messages from start to end, ns of log time: a chunk, or records
    outside of chunks. channels: those in it, None where that is not known."""

    start: int
    file: int
    offset: int
    end: int
    length: int
    channels: frozenset | None


@dataclass
class Index:
    """What an MCAP file holds; fault: in words, why not all of it could be found."""

    schemas: dict = field(default_factory=dict)
    channels: dict = field(default_factory=dict)
    counts: Counter = field(default_factory=Counter)
    pieces: list = field(default_factory=list)
    fault: str = ""

    @property
    def start(self):
        """Log time of the first message, ns, or None."""
        return min((p.start for p in self.pieces), default=None)

    @property
    def seconds(self):
        """From the first to the last message."""
        return (max(p.end for p in self.pieces) - self.start) / NS if self.pieces else 0.0


class File(io.BufferedReader):
    """A file that refuses to read more than it has left, before memory is taken for it."""

    def __init__(self, path):
        super().__init__(io.FileIO(path))
        self.size = path.stat().st_size

    def read(self, n=-1):
        left = self.size - self.tell()
        if n > left:
            raise McapError(f"the file ends {n - left} bytes early")
        return super().read(n)


class Slices:
    """Bytes as a stream; what is read of them is a part of them and no copy."""

    def __init__(self, data):
        self.data, self.at = memoryview(data), 0

    def read(self, n):
        part = self.data[self.at : self.at + n]
        self.at += len(part)
        return part


def read(path):
    """The Index of the MCAP file at path; its pieces are those of file 0.

    Raises InputError for a file that is no MCAP or ends before its first message.
    """
    with File(path) as stream:
        try:
            reader = SeekingReader(stream, record_size_limit=stream.size)
        except Exception as error:  # whatever the library makes of foreign bytes
            raise InputError(
                f"{path}: not a readable MCAP file ({in_a_line(error)}); "
                f"run `mcap doctor {path.name}`"
            ) from error
        try:
            found = _of_summary(reader.get_summary())
        except Exception as error:
            found, fault = None, in_a_line(error)
        else:
            fault = ""
        return found or _scanned(stream, path, fault)


def messages(stream, piece):
    """The Message records of a piece of a File, in the order of the file.

    Raises whatever the library raises where the piece is damaged.
    """
    stream.seek(piece.offset)
    out = []
    for record in StreamReader(stream, skip_magic=True, emit_chunks=True).records:
        if isinstance(record, Chunk):
            out += [r for r in inside(record) if isinstance(r, Message)]
        elif isinstance(record, Message):
            out.append(record)
        if stream.tell() >= piece.offset + piece.length:
            return out
    return out


def inside(chunk):
    """The records of a chunk, in order; their data are parts of the chunk's, not copies."""
    slices = Slices(unpacked(chunk))
    out = []
    try:
        for record in StreamReader(slices, skip_magic=True, emit_chunks=True).records:
            out.append(record)
    except EndOfFile:  # how a stream without a footer ends; if not at its end, it is damaged
        if slices.at < len(slices.data):
            raise
    return out


def unpacked(chunk):
    """Bytes of a chunk; raises where they are not as many as it declares."""
    size = chunk.uncompressed_size
    if size > decompression.LARGEST:
        raise decompression.TooLarge(f"a chunk of {size} bytes")
    if chunk.compression not in UNPACK:
        raise McapError(f"a chunk compressed by {chunk.compression!r}")
    data = UNPACK[chunk.compression](chunk.data, size)
    if len(data) != size:
        raise McapError(f"a chunk of {len(data)} bytes instead of {size}")
    return data


UNPACK = {
    "": lambda data, size: data,
    "zstd": decompression.zstd,
    "lz4": decompression.lz4,
}


def _of_summary(summary):
    """The Index by a file's own summary; None where that does not tell all."""
    if summary is None or summary.statistics is None:
        return None
    about, chunks = summary.statistics, summary.chunk_indexes
    counts = Counter(about.channel_message_counts)
    needed = {n for c in chunks for n in c.message_index_offsets} | set(counts)
    schemas = {c.schema_id for c in summary.channels.values()} - {0}
    told = needed <= set(summary.channels) and schemas <= set(summary.schemas)
    if not told or about.chunk_count != len(chunks) or (about.message_count and not chunks):
        return None
    pieces = [
        Piece(
            *(c.message_start_time, 0, c.chunk_start_offset),
            *(c.message_end_time, c.chunk_length),
            frozenset(c.message_index_offsets) or None,
        )
        for c in chunks
        if c.message_end_time or c.message_index_offsets
    ]
    return Index(summary.schemas, summary.channels, counts, pieces)


def _scanned(stream, path, fault):
    """The Index by reading a file up to its end, or as far as that goes."""
    found, at, damaged, why = Index(), MAGIC_SIZE, 0, "its end is missing"
    stream.seek(0)
    try:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, DataEnd):
                why = ""
                break
            here, at = at, stream.tell()
            try:
                _take(found, record, here, at - here)
            except Exception:  # whatever the library makes of a damaged chunk
                damaged += 1
    except Exception as error:
        why = in_a_line(error)
    faults = []
    if damaged:
        faults.append(f"damaged chunks left out: {damaged}")
    if why:
        faults.append(
            f"breaks off after byte {at} of {stream.size} ({why}), as when the recorder was "
            "stopped hard or the disk was full"
        )
    elif fault:
        faults.append(f"its index cannot be read ({fault}); it was read from end to end")
    if faults:
        total = sum(found.counts.values())
        if not total:
            raise InputError(f"{path}: {'; '.join(faults)}, before its first whole message")
        found.fault = (
            f"{path.name}: {'; '.join(faults)}: "
            f"{total} messages of {found.seconds:.1f} s could be read"
        )
    return found


def _take(found, record, offset, length):
    """Enter one record of a file, or the records of a chunk, into an Index."""
    if isinstance(record, Schema):
        found.schemas[record.id] = record
    elif isinstance(record, Channel):
        found.channels[record.id] = record
    elif isinstance(record, Message) and record.log_time < LATEST:
        _extend(found, _piece([record], offset, length))
        found.counts[record.channel_id] += 1
    elif isinstance(record, Chunk):
        records = inside(record)
        for r in records:
            if isinstance(r, Schema | Channel):
                _take(found, r, offset, length)
        held = [r for r in records if isinstance(r, Message) and r.log_time < LATEST]
        found.counts.update(r.channel_id for r in held)
        if held:
            found.pieces.append(_piece(held, offset, length))


def _piece(held, offset, length):
    times = [m.log_time for m in held]
    channels = frozenset(m.channel_id for m in held)
    return Piece(min(times), 0, offset, max(times), length, channels)


def _extend(found, piece):
    """Add a message outside of chunks to the last piece, if that is such and not too long."""
    last = found.pieces[-1] if found.pieces else None
    if last is None or last.channels is not None or piece.offset - last.offset > LOOSE:
        found.pieces.append(piece._replace(channels=None))
        return
    found.pieces[-1] = last._replace(
        start=min(last.start, piece.start),
        end=max(last.end, piece.end),
        length=piece.offset + piece.length - last.offset,
    )
