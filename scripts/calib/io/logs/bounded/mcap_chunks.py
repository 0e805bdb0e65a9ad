"""Chunks of an MCAP file, read within bounds of memory and time.

A chunk of a few kB can unpack to gigabytes or to millions of messages. Memory here is bounded by
MAX_UNPACKED_BYTES and MAX_CHUNK_MESSAGES, and the work by the bytes that chunks take in their file:
each message costs some of them, and each of them unpacks to a limited number.
"""

import io
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, NamedTuple, cast

from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex, McapRecord, Message
from mcap.stream_reader import StreamReader

from calib.io.logs.bounded.decompression import (
    MAX_UNPACKED_BYTES,
    TooLargeError,
    decompress_lz4,
    decompress_zstd,
    find_zstd_size,
)

MAX_CHUNK_MESSAGES = 1 << 18  # a recorder's chunk of 4 MB holds at most 1 << 17
# Messages differ at least in their times, so none packs into one byte.
MIN_MESSAGE_BYTES, FREE_CHUNK_MESSAGES = 2, 1 << 8
# Of all chunks of a file; images of one colour pack 10 000 times.
FREE_UNPACKED_BYTES, MAX_UNPACKED_PER_BYTE = 1 << 31, 512
_RECORD_HEAD = struct.Struct("<BQ")  # opcode, length
# Opcode, length, log time of the first and of the last message, unpacked bytes.
_CHUNK_HEAD = struct.Struct("<BQQQQ")


class McapPiece(NamedTuple):
    """A part of an MCAP file: a chunk, or records outside of chunks.

    start_ns, end_ns: log time of its first and last message; n_bytes: in the file;
    n_unpacked_bytes: in memory; channels: ids of the channels in it, None if unknown. Pieces sort
    by start_ns, file_index and byte_offset.
    """

    start_ns: int
    file_index: int
    byte_offset: int
    end_ns: int
    n_bytes: int
    n_unpacked_bytes: int
    channels: frozenset[int] | None


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


def iter_piece_messages(stream: BoundedFile, piece: McapPiece) -> Iterator[Message]:
    """Yield the Message records of a piece, in the order of the file.

    Raises any exception of the mcap library if the piece is damaged, TooLargeError above bounds.
    """
    stream.seek(piece.byte_offset)
    for record in StreamReader(stream, skip_magic=True, emit_chunks=True).records:
        if isinstance(record, Chunk):
            yield from (r for r in iter_chunk_records(record) if isinstance(r, Message))
        elif isinstance(record, Message):
            yield record
        if stream.tell() >= piece.byte_offset + piece.n_bytes:
            return


def iter_chunk_records(chunk: Chunk) -> Iterator[McapRecord]:
    """Yield the records of a chunk, in order; their data are views of the chunk's, not copies.

    Raises TooLargeError if there are more messages than allowed.
    """
    slices, n_messages = SliceStream(decompress_chunk(chunk)), 0
    max_messages = min(
        MAX_CHUNK_MESSAGES, FREE_CHUNK_MESSAGES + len(chunk.data) // MIN_MESSAGE_BYTES
    )
    try:
        # StreamReader only calls read(), which SliceStream has.
        stream = cast(IO[bytes], slices)
        for record in StreamReader(stream, skip_magic=True, emit_chunks=True).records:
            n_messages += isinstance(record, Message)
            if n_messages > max_messages:
                raise TooLargeError(f"a chunk of more than {max_messages} messages")
            yield record
    except EndOfFile:  # a stream without footer ends like this; before its end it is damaged
        if slices.position < len(slices.data):
            raise


def decompress_chunk(chunk: Chunk) -> bytes:
    """Return the decompressed bytes of a chunk; raises if their size is not the declared one."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd" and find_zstd_size(chunk.data) not in (None, size):
        raise McapError(f"a chunk that declares {size} bytes and holds another number")
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


def read_chunk_sizes(stream: BoundedFile, chunks: list[ChunkIndex]) -> dict[int, int]:
    """Return {offset: unpacked bytes} by the own headers of the chunks that an index lists.

    Reads a few bytes per chunk, in the order of the file. Raises McapError unless the index lists
    each chunk once, with the length and the times of its header.
    """
    end, sizes = 0, {}
    for chunk in sorted(chunks, key=lambda c: c.chunk_start_offset):
        offset = chunk.chunk_start_offset
        if offset < end:
            raise McapError(f"two of its chunks share byte {offset}")
        end = offset + chunk.chunk_length
        if end > stream.size:
            raise McapError(f"a chunk ends at byte {end} of {stream.size}")
        stream.seek(offset)
        *found, sizes[offset] = _CHUNK_HEAD.unpack(stream.read(_CHUNK_HEAD.size))
        length = chunk.chunk_length - _RECORD_HEAD.size
        if found != [Opcode.CHUNK, length, chunk.message_start_time, chunk.message_end_time]:
            raise McapError(f"it differs from the chunk at byte {offset}")
    return sizes


def require_bounded_unpacking(n_unpacked_bytes: int, n_file_bytes: int) -> None:
    """Raise TooLargeError if the chunks of a file unpack to more than its size allows."""
    limit = FREE_UNPACKED_BYTES + MAX_UNPACKED_PER_BYTE * n_file_bytes
    if n_unpacked_bytes > limit:
        raise TooLargeError(
            f"its chunks unpack to more than {limit / 1e9:.1f} GB, the most for its "
            f"{n_file_bytes} bytes"
        )
