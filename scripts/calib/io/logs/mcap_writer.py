"""Write ROS 2 messages to MCAP: the same messages give the same bytes."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import IO

from mcap.writer import CompressionType, Writer

from calib.io.logs.ros_messages import ROS2_TYPES, RosMessage

DEFAULT_CHUNK_BYTES = 1024 * 1024
# As rosbag2 writes it: the last message is kept for later subscribers.
LATCHED_QOS = """\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""


@dataclass(frozen=True)
class McapOptions:
    """How an MCAP is written: the name of the writing program, chunks, and quality of service by
    topic as rosbag2 writes it."""

    library: str
    chunk_bytes: int = DEFAULT_CHUNK_BYTES
    compression: CompressionType = CompressionType.ZSTD
    use_chunks: bool = True
    qos_by_topic: Mapping[str, str] = field(default_factory=dict)


def write_mcap(
    stream: IO[bytes],
    messages: Iterable[RosMessage],
    options: McapOptions,
    metadata: Mapping[str, Mapping[str, str]] | None = None,
) -> dict[str, int]:
    """Write messages in the order given, after the metadata {name: {key: text}}.

    Returns the number of messages of each topic.
    """
    writer = Writer(
        stream,
        chunk_size=options.chunk_bytes,
        compression=options.compression,
        use_chunking=options.use_chunks,
    )
    writer.start(profile="ros2", library=options.library)
    for name, texts in (metadata or {}).items():
        writer.add_metadata(name, dict(texts))
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    counts: dict[str, int] = {}
    for log_time_ns, topic, type_name, message in messages:
        if type_name not in schemas:
            schemas[type_name] = register_ros_schema(writer, type_name)
        if topic not in channels:
            qos = {"offered_qos_profiles": options.qos_by_topic.get(topic, "")}
            channels[topic] = writer.register_channel(topic, "cdr", schemas[type_name], qos)
        counts[topic] = counts.get(topic, 0) + 1
        data = bytes(ROS2_TYPES.serialize_cdr(message, type_name))
        writer.add_message(
            channels[topic],
            log_time=int(log_time_ns),
            data=data,
            publish_time=int(log_time_ns),
            sequence=counts[topic],
        )
    writer.finish()
    return counts


def register_ros_schema(writer: Writer, type_name: str) -> int:
    """Add the definition of a ROS 2 type to an MCAP; returns the number of its schema."""
    text = ROS2_TYPES.generate_msgdef(type_name, ros_version=2)[0].encode()
    return writer.register_schema(type_name, "ros2msg", text)
