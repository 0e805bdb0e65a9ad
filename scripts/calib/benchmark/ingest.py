"""What decode costs beside mcap's own reader, on the same bytes and in the same run.

The logs repeat a few scans and images with fresh stamps, at a laboratory's rates, until they are
large enough; each is removed once it is measured.
"""

import json
import multiprocessing
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

from calib import geometry, logs
from calib.benchmark import cost
from calib.benchmark.text import digits, table
from calib.sim import drivers, log

DECODE = Path(__file__).parents[2] / "decode.py"
GOALS = {"time": 1.5, "memory": 500.0}  # CPU time over that of mcap's reader; MB
BEGIN, NS = 1_700_000_000_000_000_000, 10**9
MAP, BODIES = "mocap/world", ("mocap/robot", "mocap/board", "mocap/cylinder")
LIDARS, CAMERAS = ("front", "rear"), ("left", "right")
MCS_HZ, SENSOR_HZ = 100, 10
SIZE_PX, BEAMS, COLUMNS, DIFFERENT = (1280, 1024), 16, 1800, 8
STAMP = 4  # bytes before the stamp of a message that begins with a header


@dataclass(frozen=True)
class Reading:
    """Of one reader: seconds, CPU seconds, and the most memory it took, MB."""

    wall: float
    cpu: float
    memory: float


@dataclass(frozen=True)
class Row:
    """One log: compression of its chunks, bytes of the file and of its messages, how many these
    are, and what decode and mcap's own reader took."""

    compression: str
    size: int
    content: int
    messages: int
    decode: Reading
    raw: Reading

    @property
    def ratio(self):
        """CPU time of decode over that of mcap's own reader."""
        return self.decode.cpu / self.raw.cpu


def plan(quick):
    """[(compression, bytes of messages)] of the rows."""
    small, large = (2e8, 1e9) if quick else (1e9, 1e10)
    return [("none", small), ("lz4", small), ("zstd", small), ("none", large)]


def measure(folder, quick):
    """[Row] of the plan, one after the other, below a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    return [row(folder / f"{i}.mcap", *of) for i, of in enumerate(plan(quick))]


def row(path, compression, content):
    """The Row of a log that is written to path and removed again."""
    try:
        messages, written = write(path, compression, content)
        raw = raw_reading(path)
        return Row(compression, path.stat().st_size, written, messages, decoded(path), raw)
    finally:
        path.unlink(missing_ok=True)


def scans():
    """(topic, type, [messages, serialised]) of every sensor."""
    rng = np.random.default_rng(0)
    for name in LIDARS:
        clouds = [_serialised(_cloud(rng, f"{name}_lidar")) for _ in range(DIFFERENT)]
        yield f"/{name}/points", log.CLOUD, clouds
    for name in CAMERAS:
        images = [_serialised(_image(rng, f"{name}_camera")) for _ in range(DIFFERENT)]
        yield f"/{name}/image_raw", log.IMAGE, images


def _serialised(message):
    return bytearray(log.STORE.serialize_cdr(message, message.__msgtype__))


def _cloud(rng, frame):
    """PointCloud2 of a VLP-16's turn in a room."""
    azimuth = np.linspace(-np.pi, np.pi, COLUMNS, endpoint=False)[:, None]
    elevation = np.radians(np.linspace(-15, 15, BEAMS))
    ray = np.stack(
        np.broadcast_arrays(
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation) + 0 * azimuth,
        ),
        -1,
    )
    distance = 4 / np.abs(ray[..., :2]).max(-1) + rng.normal(0, 0.01, ray.shape[:2])
    after = (np.arange(COLUMNS) * (NS // SENSOR_HZ // COLUMNS))[:, None]
    grey = rng.integers(0, 255, distance.shape)
    seen = np.ones(distance.shape, bool)
    echoes = drivers.Echoes(ray * distance[..., None], distance, grey, seen, after, BEGIN)
    return log.cloud(BEGIN, frame, "velodyne", echoes)


def _image(rng, frame):
    """Image of grey ramps with the noise of a sensor."""
    u, v = np.meshgrid(*map(np.arange, SIZE_PX))
    grey = 128 + 100 * np.sin(u / 90) * np.cos(v / 70) + rng.normal(0, 1.8, u.shape)
    spec = Camera("/", False, "mono8")
    return log.image(BEGIN, frame, spec, np.clip(grey, 0, 255).astype(np.uint8))[2]
