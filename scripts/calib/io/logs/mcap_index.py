"""Index of the messages of an MCAP file: its own, or else one built by reading the whole file."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader
from mcap.summary import Summary

from calib.geometry.units import NS_PER_S
from calib.io.logs.bounded.decompression import MAX_UNPACKED_BYTES, TooLargeError
from calib.io.logs.bounded.mcap_chunks import (
    BoundedFile,
    McapPiece,
    iter_chunk_records,
    read_chunk_sizes,
    require_bounded_unpacking,
)
from calib.io.status import InputError, summarize_error

MAX_LOG_TIME_NS = 1 << 62  # a later log time is a damaged one
MAX_LOOSE_BYTES = 1 << 20  # of messages outside of chunks that are read at a time


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


def read_mcap_index(path: Path) -> McapIndex:
    """Return the index of an MCAP file; its pieces have file_index 0.

    Raises InputError if the file is not MCAP or ends before its first message.
    """
    with BoundedFile(path) as stream:
        try:
            reader = SeekingReader(stream, record_size_limit=stream.size)
        except MemoryError:
            raise
        except Exception as error:  # the library raises any type for foreign bytes
            raise InputError(
                f"{path}: not a readable MCAP file ({summarize_error(error)}). "
                f"Run `mcap doctor {path.name}`."
            ) from error
        index, summary_error = None, ""
        try:
            index = _index_from_summary(reader.get_summary(), stream)
        except MemoryError:
            raise
        except TooLargeError as error:
            raise InputError(f"{path}: {error}. Record it again with smaller chunks.") from error
        except Exception as error:  # as above
            summary_error = summarize_error(error)
        return index or _index_from_scan(stream, path, summary_error)


def _index_from_summary(summary: Summary | None, stream: BoundedFile) -> McapIndex | None:
    """Return the index by the file's own summary, or None if the summary is incomplete.

    Raises an error of the mcap library if it differs from the file.
    """
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
    sizes = read_chunk_sizes(stream, chunks)
    admitted = [size for size in sizes.values() if size <= MAX_UNPACKED_BYTES]
    require_bounded_unpacking(sum(admitted), stream.size)
    pieces = [
        McapPiece(
            start_ns=c.message_start_time,
            file_index=0,
            byte_offset=c.chunk_start_offset,
            end_ns=c.message_end_time,
            n_bytes=c.chunk_length,
            n_unpacked_bytes=sizes[c.chunk_start_offset],
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
    too_large: list[str] = []
    n_unpacked = 0
    stream.seek(0)
    try:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, DataEnd):
                end_error = ""
                break
            start, offset = offset, stream.tell()
            if isinstance(record, Chunk) and record.uncompressed_size <= MAX_UNPACKED_BYTES:
                n_unpacked += record.uncompressed_size
                require_bounded_unpacking(n_unpacked, stream.size)
            try:
                _add_record(index, record, start, offset - start)
            except MemoryError:
                raise
            except TooLargeError as error:
                too_large.append(str(error))
            except Exception:  # the library raises any type for a damaged chunk
                n_damaged += 1
    except MemoryError:
        raise
    except Exception as error:  # as above
        end_error = summarize_error(error)
    errors = describe_left_out_chunks(n_damaged, too_large)
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


def describe_left_out_chunks(n_damaged: int, too_large: list[str]) -> list[str]:
    """Return what to say of the chunks that are left out; too_large: why each of these is."""
    errors = [f"damaged chunks left out: {n_damaged}"] if n_damaged else []
    if too_large:
        errors.append(f"too large chunks left out: {len(too_large)} ({too_large[0]})")
    return errors


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
        _add_loose_message(index, record.log_time, offset, length)
        index.counts[record.channel_id] += 1
    elif isinstance(record, Chunk):
        _add_chunk(index, record, offset, length)


def _add_chunk(index: McapIndex, chunk: Chunk, offset: int, length: int) -> None:
    """Add a chunk, and the schemas and channels in it, to an index; none of it if it is damaged."""
    counts: Counter[int] = Counter()
    start_ns, end_ns = MAX_LOG_TIME_NS, 0
    definitions = []
    for record in iter_chunk_records(chunk):
        if isinstance(record, Schema | Channel):
            definitions.append(record)
        elif isinstance(record, Message) and record.log_time < MAX_LOG_TIME_NS:
            counts[record.channel_id] += 1
            start_ns, end_ns = min(start_ns, record.log_time), max(end_ns, record.log_time)
    for definition in definitions:
        _add_record(index, definition, offset, length)
    index.counts.update(counts)
    if counts:
        index.pieces.append(
            McapPiece(
                start_ns=start_ns,
                file_index=0,
                byte_offset=offset,
                end_ns=end_ns,
                n_bytes=length,
                n_unpacked_bytes=chunk.uncompressed_size,
                channels=frozenset(counts),
            )
        )


def _add_loose_message(index: McapIndex, log_time_ns: int, offset: int, length: int) -> None:
    """Add a message outside of chunks: to the last piece if it holds such too, else as a piece."""
    last = index.pieces[-1] if index.pieces else None
    if last is None or last.channels is not None or offset - last.byte_offset > MAX_LOOSE_BYTES:
        index.pieces.append(
            McapPiece(
                start_ns=log_time_ns,
                file_index=0,
                byte_offset=offset,
                end_ns=log_time_ns,
                n_bytes=length,
                n_unpacked_bytes=length,
                channels=None,
            )
        )
        return
    n_bytes = offset + length - last.byte_offset
    index.pieces[-1] = last._replace(
        start_ns=min(last.start_ns, log_time_ns),
        end_ns=max(last.end_ns, log_time_ns),
        n_bytes=n_bytes,
        n_unpacked_bytes=n_bytes,
    )
