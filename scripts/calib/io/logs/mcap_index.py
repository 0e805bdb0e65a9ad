"""Where the messages of an MCAP file stand: from its index, else from reading it end to end."""

import io
from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader

from calib.geometry.units import NS_PER_S
from calib.io.logs.decompression import (
    MAX_UNPACKED_BYTES,
    TooLargeError,
    decompress_lz4,
    decompress_zstd,
)
from calib.io.status import InputError, summarize_error

MAX_LOG_TIME_NS = 1 << 62  # ns; a log time beyond is a wrong bit
MAX_LOOSE_BYTES = 1 << 20  # bytes of messages outside of chunks that are read at a time


class McapPiece(NamedTuple):
    """A part of a file that holds messages from start to end, ns of log time: a chunk, or records
    outside of chunks. channels: those in it, None where that is not known."""

    start_ns: int
    file_index: int
    byte_offset: int
    end_ns: int
    n_bytes: int
    channels: frozenset | None


@dataclass
class McapIndex:
    """What an MCAP file holds; fault: in words, why not all of it could be found."""

    schemas: dict = field(default_factory=dict)
    channels: dict = field(default_factory=dict)
    counts: Counter = field(default_factory=Counter)
    pieces: list = field(default_factory=list)
    read_error: str = ""

    @property
    def start_ns(self):
        """Log time of the first message, ns, or None."""
        return min((p.start_ns for p in self.pieces), default=None)

    @property
    def duration_s(self):
        """From the first to the last message."""
        return (
            (max(p.end_ns for p in self.pieces) - self.start_ns) / NS_PER_S if self.pieces else 0.0
        )


class BoundedFile(io.BufferedReader):
    """A file that refuses to read more than it has left, before memory is taken for it."""

    def __init__(self, path):
        super().__init__(io.FileIO(path))
        self.size = path.stat().st_size

    def read(self, n=-1):
        left = self.size - self.tell()
        if n > left:
            raise McapError(f"the file ends {n - left} bytes early")
        return super().read(n)


class SliceStream:
    """Bytes as a stream; what is read of them is a part of them and no copy."""

    def __init__(self, data):
        self.data, self.position = memoryview(data), 0

    def read(self, n):
        part = self.data[self.position : self.position + n]
        self.position += len(part)
        return part


def read_mcap_index(path):
    """The Index of the MCAP file at path; its pieces are those of file 0.

    Raises InputError for a file that is no MCAP or ends before its first message.
    """
    with BoundedFile(path) as stream:
        try:
            reader = SeekingReader(stream, record_size_limit=stream.size)
        except Exception as error:  # whatever the library makes of foreign bytes
            raise InputError(
                f"{path}: not a readable MCAP file ({summarize_error(error)}); "
                f"run `mcap doctor {path.name}`"
            ) from error
        try:
            found = _index_from_summary(reader.get_summary())
        except Exception as error:
            found, fault = None, summarize_error(error)
        else:
            fault = ""
        return found or _index_from_scan(stream, path, fault)


def read_piece_messages(stream, piece):
    """The Message records of a piece of a File, in the order of the file.

    Raises whatever the library raises where the piece is damaged.
    """
    stream.seek(piece.byte_offset)
    out = []
    for record in StreamReader(stream, skip_magic=True, emit_chunks=True).records:
        if isinstance(record, Chunk):
            out += [r for r in read_chunk_records(record) if isinstance(r, Message)]
        elif isinstance(record, Message):
            out.append(record)
        if stream.tell() >= piece.byte_offset + piece.n_bytes:
            return out
    return out


def read_chunk_records(chunk):
    """The records of a chunk, in order; their data are parts of the chunk's, not copies."""
    slices = SliceStream(decompress_chunk(chunk))
    out = []
    try:
        for record in StreamReader(slices, skip_magic=True, emit_chunks=True).records:
            out.append(record)
    except EndOfFile:  # how a stream without a footer ends; if not at its end, it is damaged
        if slices.position < len(slices.data):
            raise
    return out


def decompress_chunk(chunk):
    """Bytes of a chunk; raises where they are not as many as it declares."""
    size = chunk.uncompressed_size
    if size > MAX_UNPACKED_BYTES:
        raise TooLargeError(f"a chunk of {size} bytes")
    if chunk.compression not in CHUNK_DECOMPRESSORS:
        raise McapError(f"a chunk compressed by {chunk.compression!r}")
    data = CHUNK_DECOMPRESSORS[chunk.compression](chunk.data, size)
    if len(data) != size:
        raise McapError(f"a chunk of {len(data)} bytes instead of {size}")
    return data


CHUNK_DECOMPRESSORS = {
    "": lambda data, size: data,
    "zstd": decompress_zstd,
    "lz4": decompress_lz4,
}


def _index_from_summary(summary):
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
        McapPiece(
            *(c.message_start_time, 0, c.chunk_start_offset),
            *(c.message_end_time, c.chunk_length),
            frozenset(c.message_index_offsets) or None,
        )
        for c in chunks
        if c.message_end_time or c.message_index_offsets
    ]
    return McapIndex(summary.schemas, summary.channels, counts, pieces)


def _index_from_scan(stream, path, summary_error):
    """The Index by reading a file up to its end, or as far as that goes."""
    found, at, damaged, why = McapIndex(), MAGIC_SIZE, 0, "its end is missing"
    stream.seek(0)
    try:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, DataEnd):
                why = ""
                break
            here, at = at, stream.tell()
            try:
                _add_record(found, record, here, at - here)
            except Exception:  # whatever the library makes of a damaged chunk
                damaged += 1
    except Exception as error:
        why = summarize_error(error)
    faults = []
    if damaged:
        faults.append(f"damaged chunks left out: {damaged}")
    if why:
        faults.append(
            f"breaks off after byte {at} of {stream.size} ({why}), as when the recorder was "
            "stopped hard or the disk was full"
        )
    elif summary_error:
        faults.append(f"its index cannot be read ({summary_error}); it was read from end to end")
    if faults:
        total = sum(found.counts.values())
        if not total:
            raise InputError(f"{path}: {'; '.join(faults)}, before its first whole message")
        found.read_error = (
            f"{path.name}: {'; '.join(faults)}: "
            f"{total} messages of {found.duration_s:.1f} s could be read"
        )
    return found


def _add_record(index, record, offset, length):
    """Enter one record of a file, or the records of a chunk, into an Index."""
    if isinstance(record, Schema):
        index.schemas[record.id] = record
    elif isinstance(record, Channel):
        index.channels[record.id] = record
    elif isinstance(record, Message) and record.log_time < MAX_LOG_TIME_NS:
        _add_loose_message(index, _make_piece([record], offset, length))
        index.counts[record.channel_id] += 1
    elif isinstance(record, Chunk):
        records = read_chunk_records(record)
        for r in records:
            if isinstance(r, Schema | Channel):
                _add_record(index, r, offset, length)
        held = [r for r in records if isinstance(r, Message) and r.log_time < MAX_LOG_TIME_NS]
        index.counts.update(r.channel_id for r in held)
        if held:
            index.pieces.append(_make_piece(held, offset, length))


def _make_piece(records, offset, length):
    times = [m.log_time for m in records]
    channels = frozenset(m.channel_id for m in records)
    return McapPiece(min(times), 0, offset, max(times), length, channels)


def _add_loose_message(index, piece):
    """Add a message outside of chunks to the last piece, if that is such and not too long."""
    last = index.pieces[-1] if index.pieces else None
    if (
        last is None
        or last.channels is not None
        or piece.byte_offset - last.byte_offset > MAX_LOOSE_BYTES
    ):
        index.pieces.append(piece._replace(channels=None))
        return
    index.pieces[-1] = last._replace(
        start_ns=min(last.start_ns, piece.start_ns),
        end_ns=max(last.end_ns, piece.end_ns),
        n_bytes=piece.byte_offset + piece.n_bytes - last.byte_offset,
    )
