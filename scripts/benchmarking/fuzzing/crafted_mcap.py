"""MCAP files written record by record, so that chunks and index can say what is not true."""

from collections.abc import Sequence
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Schema,
    Statistics,
)
from mcap.stream_reader import MAGIC_SIZE

MAGIC = b"\x89MCAP0\r\n"
CHANNEL_ID = 1
assert len(MAGIC) == MAGIC_SIZE


def make_message_records(log_times: Sequence[int], data: bytes) -> bytes:
    """Return Message records of the same data at these log times, ns."""
    record = _encode_records(
        [Message(channel_id=CHANNEL_ID, log_time=0, data=data, publish_time=0, sequence=0)]
    )
    head, tail = record[:15], record[23:]  # opcode, length, channel and sequence before log time
    if len(set(log_times)) == 1:
        return (head + log_times[0].to_bytes(8, "little") + tail) * len(log_times)
    return b"".join(head + t.to_bytes(8, "little") + tail for t in log_times)


def make_chunk(log_times: Sequence[int], data: bytes) -> Chunk:
    """Return a zstd chunk of messages of the same data at these log times, ns."""
    records = make_message_records(log_times, data)
    return Chunk(
        compression="zstd",
        data=zstandard.compress(records),
        message_start_time=min(log_times),
        message_end_time=max(log_times),
        uncompressed_crc=0,
        uncompressed_size=len(records),
    )


class CraftedMcap:
    """The records of an MCAP file with one topic; its index can be changed before it is written.

    topic: of the messages; schema: of their type, with the text of its definition.
    """

    def __init__(self, topic: str, schema: Schema, chunks: Sequence[Chunk]) -> None:
        self.definitions = [
            schema,
            Channel(
                id=CHANNEL_ID, topic=topic, message_encoding="cdr", metadata={}, schema_id=schema.id
            ),
        ]
        self._body = MAGIC + _encode_records([Header("ros2", "test"), *self.definitions])
        self.chunk_indexes: list[ChunkIndex] = []
        for chunk in chunks:
            self._add_chunk(chunk)

    def _add_chunk(self, chunk: Chunk) -> None:
        record = _encode_records([chunk])
        self.chunk_indexes.append(
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=len(self._body),
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=0,
                message_index_offsets={CHANNEL_ID: 0},
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        self._body += record

    def write(self, path: Path) -> Path:
        """Write the file with its index, and return its path."""
        body = self._body + _encode_records([DataEnd(0)])
        statistics = Statistics(
            attachment_count=0,
            channel_count=1,
            channel_message_counts={CHANNEL_ID: len(self.chunk_indexes)},
            chunk_count=len(self.chunk_indexes),
            message_count=len(self.chunk_indexes),
            message_end_time=0,
            message_start_time=0,
            metadata_count=0,
            schema_count=1,
        )
        summary = [*self.definitions, statistics, *self.chunk_indexes]
        tail = _encode_records([*summary, Footer(len(body), 0, 0)])
        path.write_bytes(body + tail + MAGIC)
        return path


def _encode_records(records: Sequence[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())
