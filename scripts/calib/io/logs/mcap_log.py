"""Logs in MCAP files with ROS messages; a file without its end is read as far as possible."""

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator
from heapq import heappop, heappush
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeAlias

from mcap.records import Message

from calib.io.logs.bounded.decompression import MAX_UNPACKED_BYTES, TooLargeError
from calib.io.logs.bounded.mcap_chunks import BoundedFile, McapPiece, iter_piece_messages
from calib.io.logs.bounded.overlap_budget import ChunkSpan, require_bounded_overlap
from calib.io.logs.log_message import LogMessage, TopicInfo, missing_message_error
from calib.io.logs.mcap_index import (
    MAX_LOG_TIME_NS,
    McapIndex,
    describe_left_out_chunks,
    read_mcap_index,
)
from calib.io.logs.message_types import MessageCodec, MessageTypes, full_type_name
from calib.io.safe_names import NameGate
from calib.io.status import InputError, summarize_error

NO_SCHEMA_TYPE = "without schema"
OVERLAP_REMEDY = "Run `mcap sort` and use its output."


class _Channel(NamedTuple):
    """A topic of one file, and the decoder of its messages."""

    topic: str
    codec: MessageCodec


class _Entry(NamedTuple):
    """A message and its place; `order` sorts the messages of a log."""

    log_time_ns: int
    file_index: int
    byte_offset: int  # of its piece
    index_in_piece: int
    record: Message

    @property
    def order(self) -> tuple[int, int, int, int]:
        """Return the place of the message in the log."""
        return self.log_time_ns, self.file_index, self.byte_offset, self.index_in_piece


# A heap of pieces that overlap: place of the next entry, that entry, and those after it.
OpenPieces: TypeAlias = list[tuple[tuple[int, ...], _Entry, Iterator[_Entry]]]


class McapLog:
    """A recording in one or more MCAP files, in the order of their first messages."""

    def __init__(self, files: list[Path]) -> None:
        indexes = sorted(
            ((read_mcap_index(path), path) for path in files),
            key=lambda f: (f[0].start_ns is None, f[0].start_ns),
        )
        self.files = [path for _, path in indexes]
        self.topics: dict[str, TopicInfo] = {}
        self.names = NameGate()
        self.temporary_folder: TemporaryDirectory[str] | None = None
        self._damaged_pieces: set[tuple[int, int]] = set()  # file_index, byte_offset
        self._too_large_pieces: dict[tuple[int, int], str] = {}  # why, by the same
        self._bad_log_times: set[tuple[int, int, int]] = set()  # order without log time
        self._index_errors = [index.read_error for index, _ in indexes if index.read_error]
        self._types = MessageTypes(str(self.files[0]))
        self._channels = [self._register_channels(index) for index, _ in indexes]
        self._pieces_by_file = [
            sorted(piece._replace(file_index=n) for piece in index.pieces)
            for n, (index, _) in enumerate(indexes)
        ]
        # Log time of the last message in a piece or in one before it.
        self._last_times = [
            list(accumulate((p.end_ns for p in pieces), max)) for pieces in self._pieces_by_file
        ]
        self._pieces = sorted(piece for pieces in self._pieces_by_file for piece in pieces)
        # A larger chunk is refused when it is read.
        require_bounded_overlap(
            self.files[0],
            [
                ChunkSpan(p.start_ns, p.end_ns, p.n_unpacked_bytes)
                for p in self._pieces
                if p.n_unpacked_bytes <= MAX_UNPACKED_BYTES
            ],
            OVERLAP_REMEDY,
        )
        self.start_ns = self._pieces[0].start_ns if self._pieces else 0
        self._open_file: tuple[int, BoundedFile] | None = None

    @property
    def read_errors(self) -> list[str]:
        """Return what could not be read of the files up to now."""
        counts = Counter(file for file, _ in self._damaged_pieces)
        errors = []
        for n, path in enumerate(self.files):
            too_large = [why for (file, _), why in self._too_large_pieces.items() if file == n]
            left_out = describe_left_out_chunks(counts[n], too_large)
            errors += [f"{path.name}: {text}" for text in left_out]
        if self._bad_log_times:
            errors.append(f"messages of impossible log times left out: {len(self._bad_log_times)}")
        return self._index_errors + errors

    def _register_channels(self, index: McapIndex) -> dict[int, _Channel]:
        """Return the channels of a file by id, and add their topics and types to the log."""
        out = {}
        for number, channel in sorted(index.channels.items()):
            schema = index.schemas.get(channel.schema_id)
            admit = self.names.admit
            topic = admit(channel.topic)
            name = admit(full_type_name(schema.name)) if schema else NO_SCHEMA_TYPE
            earlier = self.topics.get(topic, TopicInfo(name, 0))
            n_messages = earlier.n_messages + index.counts.get(number, 0)
            self.topics[topic] = TopicInfo(name, n_messages)
            if schema:
                text = bytes(schema.data).decode(errors="replace")
                self._types.add_definition(name, schema.encoding, text)
            codec = self._types.make_codec(name, channel.message_encoding)
            out[number] = _Channel(topic, codec)
        return out

    def _wanted_channels(self, topics: Iterable[str]) -> list[set[int]]:
        """Return the ids of the channels of the topics, for each file."""
        topics = set(topics)
        return [{n for n, c in found.items() if c.topic in topics} for found in self._channels]

    def iter_messages(
        self, topics: Iterable[str], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[LogMessage]:
        """Yield the messages of the topics with start_ns <= log time < end_ns, by log time."""
        # Messages by topic at the last log time, and that time, for each file.
        counts: list[Counter[str]] = [Counter() for _ in self.files]
        last_ns: list[int | None] = [None] * len(self.files)
        for entry in self._iter_entries(self._wanted_channels(topics), start_ns, end_ns):
            file = entry.file_index
            if entry.log_time_ns != last_ns[file]:
                counts[file], last_ns[file] = Counter(), entry.log_time_ns
            topic, codec = self._channels[file][entry.record.channel_id]
            yield LogMessage(
                topic=topic,
                file_index=file,
                log_time_ns=entry.log_time_ns,
                index_at_log_time=counts[file][topic],
                data=entry.record.data,
                codec=codec,
            )
            counts[file][topic] += 1

    def _iter_entries(
        self, wanted: list[set[int]], start_ns: int | None, end_ns: int | None
    ) -> Iterator[_Entry]:
        """Yield entries in order, with only those pieces in memory that overlap in time."""
        open_pieces: OpenPieces = []
        for piece in self._pieces:
            channels = wanted[piece.file_index]
            if not (piece.channels is None or piece.channels & channels):
                continue
            if (end_ns is not None and piece.start_ns >= end_ns) or (
                start_ns is not None and piece.end_ns < start_ns
            ):
                continue
            # No later piece holds a message before the start of this one.
            first = (piece.start_ns, piece.file_index, piece.byte_offset, 0)
            yield from _merge_entries(open_pieces, first)
            entries = self._read_entries(piece, channels, start_ns, end_ns)
            _open_piece(open_pieces, iter(sorted(entries, key=lambda e: e.order)))
        yield from _merge_entries(open_pieces, None)

    def _read_entries(
        self,
        piece: McapPiece,
        channels: set[int],
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> list[_Entry]:
        """Return the entries of a piece; a damaged piece has none and is noted as damaged."""
        path = self.files[piece.file_index]
        first_ns = start_ns or 0
        last_ns = MAX_LOG_TIME_NS if end_ns is None else end_ns
        entries = []
        try:
            stream = self._open_stream(piece.file_index)
            for n, record in enumerate(iter_piece_messages(stream, piece)):
                # A chunk's own header may be wrong, too.
                if not piece.start_ns <= record.log_time <= min(piece.end_ns, MAX_LOG_TIME_NS - 1):
                    self._bad_log_times.add((piece.file_index, piece.byte_offset, n))
                elif first_ns <= record.log_time < last_ns and record.channel_id in channels:
                    entries.append(
                        _Entry(
                            log_time_ns=record.log_time,
                            file_index=piece.file_index,
                            byte_offset=piece.byte_offset,
                            index_in_piece=n,
                            record=record,
                        )
                    )
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({summarize_error(error)})") from error
        except MemoryError:
            raise
        except TooLargeError as error:
            self._too_large_pieces[piece.file_index, piece.byte_offset] = str(error)
            return []
        except Exception:  # the library raises any type for a damaged chunk
            self._damaged_pieces.add((piece.file_index, piece.byte_offset))
            return []
        return entries

    def _open_stream(self, file_index: int) -> BoundedFile:
        """Return a file, which stays open until another one is needed."""
        if self._open_file is None or self._open_file[0] != file_index:
            self._open_file = file_index, BoundedFile(self.files[file_index])
        return self._open_file[1]

    def _find_pieces(self, file_index: int, log_time_ns: int) -> list[McapPiece]:
        """Return the pieces of a file that may hold messages of a log time."""
        pieces, last_times = self._pieces_by_file[file_index], self._last_times[file_index]
        end = bisect_right(pieces, log_time_ns, key=lambda p: p.start_ns)
        begin = bisect_left(last_times, log_time_ns)
        return [p for p in pieces[begin:end] if p.end_ns >= log_time_ns]

    def read_message_content(
        self, topic: str, file_index: int, log_time_ns: int, index_at_log_time: int
    ) -> Any:
        """Return the content of one message, found by its place in the log."""
        channels = self._wanted_channels([topic])[file_index]
        pieces = self._find_pieces(file_index, log_time_ns)
        entries = sorted(
            (
                entry
                for piece in pieces
                for entry in self._read_entries(piece, channels, log_time_ns, log_time_ns + 1)
            ),
            key=lambda e: e.order,
        )
        if index_at_log_time >= len(entries):
            raise missing_message_error(self.files[file_index], topic, log_time_ns)
        record = entries[index_at_log_time].record
        return self._channels[file_index][record.channel_id].codec.decode(record.data)


def _open_piece(open_pieces: OpenPieces, entries: Iterator[_Entry]) -> None:
    """Add the entries of a piece to the heap of open pieces, unless there are none left."""
    first = next(entries, None)
    if first is not None:
        heappush(open_pieces, (first.order, first, entries))


def _merge_entries(open_pieces: OpenPieces, end: tuple[int, ...] | None) -> Iterator[_Entry]:
    """Yield the entries of open pieces in order, those before a place, or all."""
    while open_pieces and (end is None or open_pieces[0][0] < end):
        _, entry, rest = heappop(open_pieces)
        yield entry
        _open_piece(open_pieces, rest)
