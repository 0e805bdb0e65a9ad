"""Bound of the chunks of a log that overlap in time, which must be in memory together."""

from collections.abc import Iterable
from heapq import heappop, heappush
from pathlib import Path
from typing import NamedTuple

from calib.io.logs.bounded.decompression import MAX_UNPACKED_BYTES
from calib.io.status import InputError

MAX_OVERLAPPING_CHUNKS = 128  # to find one message, all that overlap there are read


class ChunkSpan(NamedTuple):
    """Log times of the first and last message of a chunk, and its size in memory."""

    start_ns: int
    end_ns: int
    n_bytes: int


def require_bounded_overlap(path: Path, spans: Iterable[ChunkSpan], remedy: str) -> None:
    """Raise InputError if too many chunks, or too large ones, hold messages of the same time."""
    open_spans: list[tuple[int, int]] = []  # end, size: a heap
    n_bytes = 0
    for span in sorted(spans):
        while open_spans and open_spans[0][0] < span.start_ns:
            n_bytes -= heappop(open_spans)[1]
        heappush(open_spans, (span.end_ns, span.n_bytes))
        n_bytes += span.n_bytes
        if len(open_spans) > MAX_OVERLAPPING_CHUNKS or n_bytes > 2 * MAX_UNPACKED_BYTES:
            raise InputError(
                f"{path}: {len(open_spans)} chunks of {n_bytes / 1e6:.0f} MB hold messages of the "
                f"same log time {span.start_ns} ns; expected at most {MAX_OVERLAPPING_CHUNKS} "
                f"chunks of {2 * MAX_UNPACKED_BYTES / 1e6:.0f} MB. {remedy}"
            )
