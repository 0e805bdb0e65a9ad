"""What a log holds, read in one pass: poses of motion capture and one row per sensor message."""

from collections import Counter

import numpy as np

from calib.decoding import sensor_probe, stream_clocks
from calib.io import parquet_tables, table_schemas
from calib.io.logs import message_headers
from calib.io.status import InputError, as_defined
from calib.mocap.messages import pose_messages
from calib.mocap.pose_streams import Streams
from calib.sensors.camera import camera_info

NS = stream_clocks.NS
STATIC = "/tf_static"


class Recording:
    """Streams of motion capture, rows of sensor messages, static transforms and frame ids, as they
    come; and of the messages that cannot be read, by topic, how many and the first's fault."""

    def __init__(self, options):
        self.sensors = options["sensors"]
        names = topics_of(options["mocap"])
        self.streams = Streams(options["mocap"]["map"], options["bodies"], names)
        self._name_of = {s["topic"]: name for name, s in sorted(self.sensors.items())}
        self.heard = {name: sensor_probe.KINDS[s["kind"]](s) for name, s in self.sensors.items()}
        self.frames, self.static, self.frame_ids = [], {}, {}
        self.unreadable, self.why = Counter(), {}

    def take(self, message):
        """Add what one message says."""
        try:
            with as_defined(message.type):
                self._take(message)
        except InputError as error:
            self.unreadable[message.topic] += 1
            self.why.setdefault(message.topic, str(error))

    def _take(self, message):
        if message.topic in self._name_of:
            self._frame(message, self._name_of[message.topic])
        elif message.type == camera_info.TYPE:
            self._info(message)
        elif message.type in pose_messages.TYPES:
            take = self._static if message.topic == STATIC else self.streams.take
            take(message)

    def _frame(self, message, name):
        if message.type in self.heard[name].types:
            head = message_headers.of(message)
            self.frame_ids.setdefault(name, head.frame_id)
            t = message_headers.stamp_ns(head)
            place = (message.log_t, len(message.data), message.file, message.ordinal)
            self.frames.append((name, t or -1, *place))
            self.heard[name].take(message)

    def _info(self, message):
        for name, sensor in self.sensors.items():
            if sensor.get("camera_info") == message.topic:
                self.heard[name].take_info(message.content)

    def _static(self, message):
        for pose in pose_messages.poses(message):
            edge = pose.parent, pose.body
            if not np.isfinite([*pose.xyz, *pose.quat]).all():
                raise InputError(f"the transform from {edge[0]} to {edge[1]} is not a number")
            self.static[edge] = {"xyz_m": list(pose.xyz), "quat_xyzw": list(pose.quat)}


def topics_of(mocap):
    """{topic: body that it names, or None} of the block `mocap` of a rig."""
    topics = mocap["topics"]
    return dict(topics) if isinstance(topics, dict) else dict.fromkeys(topics)


def read(log, options):
    """The Recording of a log, within from_s and to_s after its first message; static transforms,
    which are sent once, also from before, and first, for they tell which frames are wanted."""
    recording, sensors = Recording(options), options["sensors"].values()
    infos = [s["camera_info"] for s in sensors if "camera_info" in s]
    topics = (*topics_of(options["mocap"]), *(s["topic"] for s in sensors), *infos)
    start, end = _bounds(log, options)
    if STATIC in log.topics:
        for message in log.messages([STATIC], None, end):
            recording.take(message)
        recording.streams.want_parents(recording.static)
    wanted = sorted({t for t in topics if t in log.topics and t != STATIC})
    for message in log.messages(wanted, start, end):
        recording.take(message)
    return recording


def _bounds(log, options):
    """First and last log time, ns, that from_s and to_s allow; None where they are not given."""
    return [
        None if options[k] is None else log.start + round(options[k] * NS)
        for k in ("from_s", "to_s")
    ]


def clocks(recording):
    """{topic of motion capture or name of a sensor: stamps.Clock}."""
    streams = {}
    for topic, edges in recording.streams.by_topic().items():
        most = max(edges.values(), key=lambda c: len(c["t"]))
        streams[topic] = most["t"], most["log_t"]
    for name in sorted(recording.sensors):
        rows = [f for f in recording.frames if f[0] == name]
        if rows:
            streams[name] = tuple(np.array([f[1:3] for f in rows], np.int64).T)
    return stream_clocks.clocks(streams)


def frame_columns(frames, clocks):
    """Columns of frames.parquet: sensors by name, messages by place in the log."""
    if not frames:
        return parquet_tables.empty(table_schemas.FRAMES)
    frames = sorted(frames, key=lambda f: (f[0], f[4], f[2], f[5]))
    columns = dict(
        zip(table_schemas.FRAMES.names, map(np.array, zip(*frames, strict=True)), strict=True)
    )
    for name in sorted(set(columns["sensor"].tolist())):
        rows = columns["sensor"] == name
        columns["t"][rows] = clocks[name].times(columns["t"][rows], columns["log_t"][rows])
    return columns


def rate(t):
    """Hz from stamps t, ns; 0 where there is none."""
    steps = np.diff(t) / NS
    return float(1 / np.median(steps)) if len(steps) and np.median(steps) > 0 else 0.0
