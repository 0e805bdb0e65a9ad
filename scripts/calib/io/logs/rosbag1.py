"""Logs in ROS 1 bags."""

import io
import os
from collections.abc import Callable, Collection, Generator
from functools import partial
from pathlib import Path
from typing import Any

from rosbags import rosbag1
from rosbags.interfaces import Connection
from rosbags.rosbag1.reader import Chunk, IndexData, ReaderError, decompressors

from calib.io.logs.bounded.decompression import (
    MAX_UNPACKED_BYTES,
    decompress_bzip2,
    decompress_lz4,
)
from calib.io.logs.rosbags_reader import RosbagsLog, open_readers

ROSBAG1_REMEDY = "Run `rosbag reindex {}` and use its output."
MAX_REREADS = 16  # of a chunk in one pass by time
BOUNDED_DECOMPRESSORS = {
    decompressors["bz2"]: decompress_bzip2,
    decompressors["lz4"]: decompress_lz4,
}


class ClampedFile(io.BufferedReader):
    """A file whose read() allocates no more than the file holds."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self.size = path.stat().st_size

    def read(self, n: int | None = -1) -> bytes:
        left = max(0, self.size - self.tell())
        return super().read(left if n is None or n < 0 else min(n, left))


class ClampedPath(type(Path())):  # type: ignore[misc]  # the class of paths of this system
    """A path whose file is a ClampedFile."""

    def open(self, *arguments: Any, **options: Any) -> ClampedFile:
        """Open the file for reading."""
        return ClampedFile(Path(self))


class BoundedBagReader(rosbag1.Reader):
    """A reader whose memory and work are bounded by the bytes of the file.

    Each byte of the index is read once; chunks may be read again MAX_REREADS times, because their
    messages may overlap in time; and messages hold no more bytes than their chunks.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(ClampedPath(path))
        self.size = path.stat().st_size
        self._chunk_positions: set[int] = set()
        self._n_index_bytes = self._n_read = self._n_unpacked = self._n_yielded = 0

    def open(self) -> None:
        """Open the file and replace the decompressors of its chunks."""
        super().open()
        for offset, chunk in self.chunks.items():
            bounded = BOUNDED_DECOMPRESSORS.get(chunk.decompressor, chunk.decompressor)
            self.chunks[offset] = chunk._replace(decompressor=partial(self._unpack, bounded))

    def read_chunk(self) -> Chunk:
        """Read the header of a chunk; raises ReaderError if it was read before."""
        assert self.bio
        position = self.bio.tell()
        if position in self._chunk_positions:
            raise ReaderError(f"the index lists the chunk at byte {position} twice")
        self._chunk_positions.add(position)
        return super().read_chunk()

    def read_index_data(self, pos: int, indexes: dict[int, list[IndexData]]) -> None:
        """Read index data; raises ReaderError if more was read than the file holds."""
        assert self.bio
        begin = self.bio.tell()
        super().read_index_data(pos, indexes)
        self._n_index_bytes += self.bio.tell() - begin
        if self._n_index_bytes > self.size:
            raise ReaderError(f"the index of its chunks overlaps itself at byte {begin}")

    def messages(
        self,
        connections: Collection[Connection] = (),
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield messages by time; raises ReaderError if they take more than the file can hold."""
        open_chunk = self.current_chunk[1]
        self._n_read = self._n_yielded = 0
        self._n_unpacked = 0 if open_chunk.closed else open_chunk.seek(0, os.SEEK_END)
        for connection, time_ns, data in super().messages(connections, start, stop):
            self._n_yielded += len(data)
            if self._n_yielded > self._n_unpacked:
                raise ReaderError("its messages overlap in its chunks")
            yield connection, time_ns, data

    def _unpack(self, decompress: Callable[[bytes], bytes], data: bytes) -> bytes:
        self._n_read += len(data)
        if self._n_read > MAX_REREADS * self.size + MAX_UNPACKED_BYTES:
            raise ReaderError(f"its chunks overlap in time: each is read {MAX_REREADS} times")
        unpacked = decompress(data)
        self._n_unpacked += len(unpacked)
        return unpacked


def open_rosbag1(files: list[Path]) -> RosbagsLog:
    """Return the log in ROS 1 bags."""
    opened = open_readers(files, BoundedBagReader, ROSBAG1_REMEDY)
    return RosbagsLog(opened, lambda connection: "ros1")
