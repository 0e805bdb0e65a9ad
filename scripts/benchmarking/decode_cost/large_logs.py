"""Logs of any size: a few scans and images, repeated with fresh stamps at a laboratory's rates."""

import struct

import numpy as np
from mcap.writer import CompressionType, Writer

from calib.geometry import se3
from simulation import ros_log, simulated_rigs
from simulation.sensors import cloud_formats

COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}
BEGIN, NS = 1_700_000_000 * 10**9, 10**9
MAP, BODIES = "mocap/world", ("mocap/robot", "mocap/board", "mocap/cylinder")
LIDARS, CAMERAS = ("front", "rear"), ("left", "right")
MCS_HZ, SENSOR_HZ = 100, 10
BEAMS, COLUMNS, SIZE_PX = 16, 1800, (1280, 1024)
DIFFERENT = 8  # messages of a sensor that take turns
STAMP_AT = 4  # byte of a serialised message that begins with a header


def write(path, compression, content):
    """Write an MCAP of `content` bytes of messages, or a little more; returns their number."""
    with path.open("wb") as stream:
        # The checksum of a chunk takes longer than its bytes, and no reader here asks for it.
        kind = COMPRESSIONS[compression]
        writer = Writer(stream, chunk_size=1 << 20, compression=kind, enable_crcs=False)
        writer.start(profile="ros2", library="benchmark")
        channels, written, count = _channels(writer), 0, 0
        for log_t, topic, data in _messages():
            writer.add_message(channels[topic], log_t, data, log_t, count)
            written, count = written + len(data), count + 1
            if written >= content:
                break
        writer.finish()
    return count


def sensors():
    """{sensor: what decode is told of it}."""
    lidars = {n: {"kind": "lidar", "topic": f"/{n}/points", "point_time": {}} for n in LIDARS}
    cameras = {n: {"kind": "camera", "topic": f"/{n}/image_raw"} for n in CAMERAS}
    return lidars | cameras


def _channels(writer):
    """{topic: channel} of all that a log holds."""
    kinds = {"camera": ros_log.IMAGE, "lidar": ros_log.CLOUD}
    types = {"/tf": ros_log.TF} | {s["topic"]: kinds[s["kind"]] for s in sensors().values()}
    out = {}
    for topic, name in types.items():
        text = ros_log.STORE.generate_msgdef(name, ros_version=2)[0].encode()
        schema = writer.register_schema(name, "ros2msg", text)
        out[topic] = writer.register_channel(topic, "cdr", schema)
    return out


def _messages():
    """(log time, ns, topic, bytes) without an end, by log time."""
    rng = np.random.default_rng(0)
    make = {"lidar": _cloud, "camera": _image}
    pools = {
        s["topic"]: [make[s["kind"]](rng, name) for _ in range(DIFFERENT)]
        for name, s in sensors().items()
    }
    poses = {body: se3.pose(t=[i, 0, 1.0]) for i, body in enumerate(BODIES)}
    tick = 0
    while True:
        t = BEGIN + tick * (NS // MCS_HZ)
        poses = {b: T @ se3.se3_exp(rng.normal(0, 1e-3, 6)) for b, T in poses.items()}
        yield t, "/tf", _serialised(ros_log.transforms(t, MAP, poses))
        turn, between = divmod(tick, MCS_HZ // SENSOR_HZ)
        if between == 0:
            for topic, pool in pools.items():
                data, stamp = pool[turn % DIFFERENT], t - NS // SENSOR_HZ
                struct.pack_into("<iI", data, STAMP_AT, stamp // NS, stamp % NS)
                yield t, topic, data
        tick += 1


def _serialised(message):
    return bytearray(ros_log.STORE.serialize_cdr(message, message.__msgtype__))


def _cloud(rng, frame):
    """PointCloud2 of a turn in a square room."""
    azimuth = np.linspace(-np.pi, np.pi, COLUMNS, endpoint=False)[:, None]
    elevation = np.radians(np.linspace(-15, 15, BEAMS))
    ray = np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation)]
        + [np.broadcast_to(np.sin(elevation), (COLUMNS, BEAMS))],
        -1,
    )
    distance = 4 / np.abs(ray[..., :2]).max(-1) + rng.normal(0, 0.01, ray.shape[:2])
    after = np.arange(COLUMNS)[:, None] * (NS // SENSOR_HZ // COLUMNS)
    grey, seen = rng.integers(0, 255, distance.shape), np.ones(distance.shape, bool)
    echoes = cloud_formats.Echoes(ray * distance[..., None], distance, grey, seen, after, BEGIN)
    return _serialised(ros_log.cloud(BEGIN, frame, "velodyne", echoes))


def _image(rng, frame):
    """Image of grey waves with a sensor's noise."""
    u, v = np.meshgrid(*map(np.arange, SIZE_PX))
    grey = 128 + 100 * np.sin(u / 90) * np.cos(v / 70) + rng.normal(0, 1.8, u.shape)
    spec = simulated_rigs.Camera("", (), (), "", (), SIZE_PX, encoding="mono8")
    pixels = np.clip(grey, 0, 255).astype(np.uint8)
    return _serialised(ros_log.image(BEGIN, frame, spec, pixels)[2])
