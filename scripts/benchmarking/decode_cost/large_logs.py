"""Write large logs: a few scans and images, repeated with new stamps at typical rates."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from calib.geometry.se3 import make_pose, se3_exp
from calib.geometry.units import NS_PER_S
from calib.io.logs import ros_messages
from calib.io.logs.ros_messages import CLOUD_TYPE, IMAGE_TYPE, TF_TYPE, make_tf_message
from simulation.ros_log import make_cloud_message, make_image_message
from simulation.sensors.cloud_formats import Echoes
from simulation.simulated_rigs import SimulatedCamera

COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}
LARGE_LOG_START_NS = 1_700_000_000 * NS_PER_S
MAP_FRAME, BODY_NAMES = "mocap/world", ("mocap/robot", "mocap/board", "mocap/cylinder")
LIDAR_NAMES, CAMERA_NAMES = ("front", "rear"), ("left", "right")
MCS_HZ, SENSOR_HZ = 100, 10
N_BEAMS, N_COLUMNS, IMAGE_SIZE_PX = 16, 1800, (1280, 1024)
N_DISTINCT_MESSAGES = 8  # messages of a sensor that are repeated in turn
STAMP_BYTE_OFFSET = 4  # in a serialised message that begins with a header


def write_large_log(path: Path, compression: str, min_content_bytes: float) -> int:
    """Write an MCAP with at least min_content_bytes of messages; return their number."""
    with path.open("wb") as stream:
        # Without checksums, which take longer than writing and which no reader here uses.
        kind = COMPRESSIONS[compression]
        writer = Writer(stream, chunk_size=1 << 20, compression=kind, enable_crcs=False)
        writer.start(profile="ros2", library="benchmark")
        channels, written, count = _register_channels(writer), 0, 0
        for log_t, topic, data in _generate_messages():
            writer.add_message(channels[topic], log_t, data, log_t, count)
            written, count = written + len(data), count + 1
            if written >= min_content_bytes:
                break
        writer.finish()
    return count


def large_log_sensors() -> dict[str, Any]:
    """Return the blocks of the sensors for the options of decode, by name."""
    lidars = {n: {"kind": "lidar", "topic": f"/{n}/points", "point_time": {}} for n in LIDAR_NAMES}
    cameras = {n: {"kind": "camera", "topic": f"/{n}/image_raw"} for n in CAMERA_NAMES}
    return lidars | cameras


def _register_channels(writer: Writer) -> dict[str, int]:
    """Register all topics of a log; return their channels."""
    kinds = {"camera": IMAGE_TYPE, "lidar": CLOUD_TYPE}
    types = {"/tf": TF_TYPE} | {s["topic"]: kinds[s["kind"]] for s in large_log_sensors().values()}
    out = {}
    for topic, name in types.items():
        text = ros_messages.ROS2_TYPES.generate_msgdef(name, ros_version=2)[0].encode()
        schema = writer.register_schema(name, "ros2msg", text)
        out[topic] = writer.register_channel(topic, "cdr", schema)
    return out


def _generate_messages() -> Iterator[tuple[int, str, bytes]]:
    """Yield (log time, ns; topic; bytes) endlessly, in the order of log time."""
    rng = np.random.default_rng(0)
    make = {"lidar": _make_cloud_bytes, "camera": _make_image_bytes}
    pools = {
        s["topic"]: [make[s["kind"]](rng, name) for _ in range(N_DISTINCT_MESSAGES)]
        for name, s in large_log_sensors().items()
    }
    poses = {body: make_pose(t=[i, 0, 1.0]) for i, body in enumerate(BODY_NAMES)}
    tick = 0
    while True:
        t = LARGE_LOG_START_NS + tick * (NS_PER_S // MCS_HZ)
        poses = {b: T @ se3_exp(rng.normal(0, 1e-3, 6)) for b, T in poses.items()}
        yield t, "/tf", bytes(_serialize_message(make_tf_message(t, MAP_FRAME, poses)))
        turn, between = divmod(tick, MCS_HZ // SENSOR_HZ)
        if between == 0:
            for topic, pool in pools.items():
                data, stamp = pool[turn % N_DISTINCT_MESSAGES], t - NS_PER_S // SENSOR_HZ
                struct.pack_into(
                    "<iI", data, STAMP_BYTE_OFFSET, stamp // NS_PER_S, stamp % NS_PER_S
                )
                yield t, topic, bytes(data)
        tick += 1


def _serialize_message(message: Any) -> bytearray:
    return bytearray(ros_messages.ROS2_TYPES.serialize_cdr(message, message.__msgtype__))


def _make_cloud_bytes(rng: np.random.Generator, frame: str) -> bytearray:
    """Return a serialised PointCloud2 of one scan in a square room."""
    azimuth = np.linspace(-np.pi, np.pi, N_COLUMNS, endpoint=False)[:, None]
    elevation = np.radians(np.linspace(-15, 15, N_BEAMS))
    ray = np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation)]
        + [np.broadcast_to(np.sin(elevation), (N_COLUMNS, N_BEAMS))],
        -1,
    )
    distance = 4 / np.abs(ray[..., :2]).max(-1) + rng.normal(0, 0.01, ray.shape[:2])
    after = np.arange(N_COLUMNS)[:, None] * (NS_PER_S // SENSOR_HZ // N_COLUMNS)
    grey, seen = rng.integers(0, 255, distance.shape), np.ones(distance.shape, bool)
    echoes = Echoes(ray * distance[..., None], distance, grey, seen, after, LARGE_LOG_START_NS)
    return _serialize_message(make_cloud_message(LARGE_LOG_START_NS, frame, "velodyne", echoes))


def _make_image_bytes(rng: np.random.Generator, frame: str) -> bytearray:
    """Return a serialised Image of grey waves with noise."""
    u, v = np.meshgrid(*map(np.arange, IMAGE_SIZE_PX))
    grey = 128 + 100 * np.sin(u / 90) * np.cos(v / 70) + rng.normal(0, 1.8, u.shape)
    spec = SimulatedCamera("", (), (), "", (), IMAGE_SIZE_PX, encoding="mono8")
    pixels = np.clip(grey, 0, 255).astype(np.uint8)
    return _serialize_message(make_image_message(LARGE_LOG_START_NS, frame, spec, pixels)[2])
