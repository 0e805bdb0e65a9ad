"""Index of the messages of an MCAP file: its own, or else one built by reading the whole file."""

import io
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, NamedTuple, cast

from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader
from mcap.summary import Summary

from calib.geometry.units import NS_PER_S
from calib.io.logs.decompression import (
    MAX_UNPACKED_BYTES,
    TooLargeError,
    decompress_lz4,
    decompress_zstd,
)
from calib.io.status import InputError, summarize_error

MAX_LOG_TIME_NS = 1 << 62  # a later log time is a damaged one
MAX_LOOSE_BYTES = 1 << 20  # of messages outside of chunks that are read at a time


class McapPiece(NamedTuple):
    """A part of an MCAP file: a chunk, or records outside of chunks.

    start_ns, end_ns: log time of its first and last message; channels: ids of the channels in it,
    None if unknown. Pieces sort by start_ns, file_index and byte_offset.
    """

    start_ns: int
    file_index: int
    byte_offset: int
    end_ns: int
    n_bytes: int
    channels: frozenset[int] | None


@dataclass
class McapIndex:
    """What an MCAP file holds.

    schemas, channels: records by id; counts: number of messages by channel id; read_error: why
    not all of the file could be read.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    pieces: list[McapPiece] = field(default_factory=list)
    read_error: str = ""

    @property
    def start_ns(self) -> int | None:
        """Return the log time of the first message, ns, or None without messages."""
        return min((p.start_ns for p in self.pieces), default=None)

    @property
    def duration_s(self) -> float:
        """Return the time from the first to the last message, s."""
        start = self.start_ns
        return 0.0 if start is None else (max(p.end_ns for p in self.pieces) - start) / NS_PER_S


class BoundedFile(io.BufferedReader):
    """A file that refuses to read past its end, before memory is allocated for it."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self.size = path.stat().st_size

    def read(self, n: int | None = -1) -> bytes:
        available = self.size - self.tell()
        if n is not None and n > available:
            raise McapError(f"the file ends {n - available} bytes early")
        return super().read(n)


class SliceStream:
    """A stream of bytes that returns views, not copies."""

    def __init__(self, data: bytes) -> None:
        self.data, self.position = memoryview(data), 0

    def read(self, n: int) -> memoryview:
        """Return the next n bytes, fewer at the end."""
        part = self.data[self.position : self.position + n]
        self.position += len(part)
        return part


def read_mcap_index(path: Path) -> McapIndex:
    """Return the index of an MCAP file; its pieces have file_index 0.

    Raises InputError if the file is not MCAP or ends before its first message.
    """
    with BoundedFile(path) as stream:
        try:
            reader = SeekingReader(stream, record_size_limit=stream.size)
        except Exception as error:  # the library raises any type for foreign bytes
            raise InputError(
                f"{path}: not a readable MCAP file ({summarize_error(error)}). "
                f"Run `mcap doctor {path.name}`."
            ) from error
        index, summary_error = None, ""
        try:
            index = _index_from_summary(reader.get_summary())
        except Exception as error:  # as above
            summary_error = summarize_error(error)
        return index or _index_from_scan(stream, path, summary_error)


def read_piece_messages(stream: BoundedFile, piece: McapPiece) -> list[Message]:
    """Return the Message records of a piece, in the order of the file.

    Raises any exception of the mcap library if the piece is damaged.
    """
    stream.seek(piece.byte_offset)
    out: list[Message] = []
    for record in StreamReader(stream, skip_magic=True, emit_chunks=True).records:
        if isinstance(record, Chunk):
            out += [r for r in read_chunk_records(record) if isinstance(r, Message)]
        elif isinstance(record, Message):
            out.append(record)
        if stream.tell() >= piece.byte_offset + piece.n_bytes:
            return out
    return out


def read_chunk_records(chunk: Chunk) -> list[McapRecord]:
    """Return the records of a chunk, in order; their data are views of the chunk's, not copies."""
    slices = SliceStream(decompress_chunk(chunk))
    out = []
    try:
        # StreamReader only calls read(), which SliceStream has.
        stream = cast(IO[bytes], slices)
        for record in StreamReader(stream, skip_magic=True, emit_chunks=True).records:
            out.append(record)
    except EndOfFile:  # a stream without footer ends like this; before its end it is damaged
        if slices.position < len(slices.data):
            raise
    return out


def decompress_chunk(chunk: Chunk) -> bytes:
    """Return the decompressed bytes of a chunk; raises if their size is not the declared one."""
    size = chunk.uncompressed_size
    if size > MAX_UNPACKED_BYTES:
        raise TooLargeError(f"a chunk of {size} bytes")
    if chunk.compression not in CHUNK_DECOMPRESSORS:
        raise McapError(f"a chunk compressed by {chunk.compression!r}")
    data = CHUNK_DECOMPRESSORS[chunk.compression](chunk.data, size)
    if len(data) != size:
        raise McapError(f"a chunk of {len(data)} bytes instead of {size}")
    return data


CHUNK_DECOMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda data, size: data,
    "zstd": decompress_zstd,
    "lz4": decompress_lz4,
}


def _index_from_summary(summary: Summary | None) -> McapIndex | None:
    """Return the index by the file's own summary, or None if the summary is incomplete."""
    if summary is None or summary.statistics is None:
        return None
    statistics, chunks = summary.statistics, summary.chunk_indexes
    counts = Counter(statistics.channel_message_counts)
    channels = {n for c in chunks for n in c.message_index_offsets} | set(counts)
    schemas = {c.schema_id for c in summary.channels.values()} - {0}
    is_complete = (
        channels <= set(summary.channels)
        and schemas <= set(summary.schemas)
        and statistics.chunk_count == len(chunks)
        and (chunks or not statistics.message_count)
    )
    if not is_complete:
        return None
    pieces = [
        McapPiece(
            start_ns=c.message_start_time,
            file_index=0,
            byte_offset=c.chunk_start_offset,
            end_ns=c.message_end_time,
            n_bytes=c.chunk_length,
            channels=frozenset(c.message_index_offsets) or None,
        )
        for c in chunks
        if c.message_end_time or c.message_index_offsets
    ]
    return McapIndex(summary.schemas, summary.channels, counts, pieces)


def _index_from_scan(stream: BoundedFile, path: Path, summary_error: str) -> McapIndex:
    """Return the index by reading a file to its end, or as far as it can be read.

    summary_error: why the file's own index cannot be read, "" if it has none.
    """
    index, offset, n_damaged, end_error = McapIndex(), MAGIC_SIZE, 0, "its end is missing"
    stream.seek(0)
    try:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, DataEnd):
                end_error = ""
                break
            start, offset = offset, stream.tell()
            try:
                _add_record(index, record, start, offset - start)
            except Exception:  # the library raises any type for a damaged chunk
                n_damaged += 1
    except Exception as error:  # as above
        end_error = summarize_error(error)
    errors = []
    if n_damaged:
        errors.append(f"damaged chunks left out: {n_damaged}")
    if end_error:
        errors.append(
            f"breaks off after byte {offset} of {stream.size} ({end_error}), as after a crash of "
            "the recorder or on a full disk"
        )
    elif summary_error:
        errors.append(f"its index cannot be read ({summary_error}); the whole file was read")
    if errors:
        index.read_error = _describe_partial_read(index, path, "; ".join(errors))
    return index


def _describe_partial_read(index: McapIndex, path: Path, errors: str) -> str:
    """Return what could be read of a damaged file; raises InputError if it is nothing."""
    n_messages = sum(index.counts.values())
    if not n_messages:
        raise InputError(f"{path}: {errors}, before its first whole message")
    return f"{path.name}: {errors}: {n_messages} messages of {index.duration_s:.1f} s could be read"


def _add_record(index: McapIndex, record: McapRecord, offset: int, length: int) -> None:
    """Add a record of a file, or the records of a chunk, to an index."""
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
        messages = [r for r in records if isinstance(r, Message) and r.log_time < MAX_LOG_TIME_NS]
        index.counts.update(r.channel_id for r in messages)
        if messages:
            index.pieces.append(_make_piece(messages, offset, length))


def _make_piece(records: list[Message], offset: int, length: int) -> McapPiece:
    times = [m.log_time for m in records]
    channels = frozenset(m.channel_id for m in records)
    return McapPiece(
        start_ns=min(times),
        file_index=0,
        byte_offset=offset,
        end_ns=max(times),
        n_bytes=length,
        channels=channels,
    )


def _add_loose_message(index: McapIndex, piece: McapPiece) -> None:
    """Add a message outside of chunks: to the last piece if it holds such too, else as a piece."""
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
