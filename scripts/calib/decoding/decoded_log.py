"""What a log holds, read in one pass: poses of motion capture and one row per sensor message."""

from collections import Counter

import numpy as np

from calib.decoding.sensor_probe import PROBE_BY_KIND
from calib.decoding.stream_clocks import match_streams_to_log
from calib.geometry.units import NS_PER_S
from calib.io.logs.message_headers import header_stamp_ns, read_message_header
from calib.io.parquet_tables import empty_columns
from calib.io.status import InputError, guard_message_fields
from calib.io.table_schemas import FRAMES_SCHEMA
from calib.mocap.messages.pose_messages import POSE_READERS, read_poses
from calib.mocap.pose_streams import MocapStreams
from calib.sensors.camera import camera_info

TF_STATIC_TOPIC = "/tf_static"


class DecodedLog:
    """Streams of motion capture, rows of sensor messages, static transforms and frame ids, as they
    come; and of the messages that cannot be read, by topic, how many and the first's fault."""

    def __init__(self, options):
        self.sensors = options["sensors"]
        names = mocap_topics(options["mocap"])
        self.streams = MocapStreams(options["mocap"]["map"], options["bodies"], names)
        self._sensor_by_topic = {s["topic"]: name for name, s in sorted(self.sensors.items())}
        self.probes = {name: PROBE_BY_KIND[s["kind"]](s) for name, s in self.sensors.items()}
        self.frame_rows, self.static_transforms, self.frame_ids = [], {}, {}
        self.n_unreadable, self.first_errors = Counter(), {}

    def add_message(self, message):
        """Add what one message says."""
        try:
            with guard_message_fields(message.type):
                self._sort_message(message)
        except InputError as error:
            self.n_unreadable[message.topic] += 1
            self.first_errors.setdefault(message.topic, str(error))

    def _sort_message(self, message):
        if message.topic in self._sensor_by_topic:
            self._add_frame(message, self._sensor_by_topic[message.topic])
        elif message.type == camera_info.CAMERA_INFO_TYPE:
            self._add_camera_info(message)
        elif message.type in POSE_READERS:
            take = (
                self._add_static_transforms
                if message.topic == TF_STATIC_TOPIC
                else self.streams.add_message
            )
            take(message)

    def _add_frame(self, message, name):
        if message.type in self.probes[name].message_types:
            head = read_message_header(message)
            self.frame_ids.setdefault(name, head.frame_id)
            t = header_stamp_ns(head)
            place = (
                message.log_time_ns,
                len(message.data),
                message.file_index,
                message.index_at_log_time,
            )
            self.frame_rows.append((name, t or -1, *place))
            self.probes[name].add_message(message)

    def _add_camera_info(self, message):
        for name, sensor in self.sensors.items():
            if sensor.get("camera_info") == message.topic:
                self.probes[name].add_camera_info(message.content)

    def _add_static_transforms(self, message):
        for pose in read_poses(message):
            edge = pose.parent, pose.body
            if not np.isfinite([*pose.xyz, *pose.quat]).all():
                raise InputError(f"the transform from {edge[0]} to {edge[1]} is not a number")
            self.static_transforms[edge] = {"xyz_m": list(pose.xyz), "quat_xyzw": list(pose.quat)}


def mocap_topics(mocap_config):
    """{topic: body that it names, or None} of the block `mocap` of a rig."""
    topics = mocap_config["topics"]
    return dict(topics) if isinstance(topics, dict) else dict.fromkeys(topics)


def decode_log(log, options):
    """The Recording of a log, within from_s and to_s after its first message; static transforms,
    which are sent once, also from before, and first, for they tell which frames are wanted."""
    recording, sensors = DecodedLog(options), options["sensors"].values()
    infos = [s["camera_info"] for s in sensors if "camera_info" in s]
    topics = (*mocap_topics(options["mocap"]), *(s["topic"] for s in sensors), *infos)
    start, end = _log_time_bounds(log, options)
    if TF_STATIC_TOPIC in log.topics:
        for message in log.iter_messages([TF_STATIC_TOPIC], None, end):
            recording.add_message(message)
        recording.streams.add_parent_frames(recording.static_transforms)
    wanted = sorted({t for t in topics if t in log.topics and t != TF_STATIC_TOPIC})
    for message in log.iter_messages(wanted, start, end):
        recording.add_message(message)
    return recording


def _log_time_bounds(log, options):
    """First and last log time, ns, that from_s and to_s allow; None where they are not given."""
    return [
        None if options[k] is None else log.start_ns + round(options[k] * NS_PER_S)
        for k in ("from_s", "to_s")
    ]


def infer_stream_clocks(recording):
    """{topic of motion capture or name of a sensor: stamps.Clock}."""
    streams = {}
    for topic, edges in recording.streams.columns_by_topic().items():
        most = max(edges.values(), key=lambda c: len(c["stamp_ns"]))
        streams[topic] = most["stamp_ns"], most["log_time_ns"]
    for name in sorted(recording.sensors):
        rows = [f for f in recording.frame_rows if f[0] == name]
        if rows:
            streams[name] = tuple(np.array([f[1:3] for f in rows], np.int64).T)
    return match_streams_to_log(streams)


def build_frame_columns(frames, clocks):
    """Columns of frames.parquet: sensors by name, messages by place in the log."""
    if not frames:
        return empty_columns(FRAMES_SCHEMA)
    frames = sorted(frames, key=lambda f: (f[0], f[4], f[2], f[5]))
    columns = dict(zip(FRAMES_SCHEMA.names, map(np.array, zip(*frames, strict=True)), strict=True))
    for name in sorted(set(columns["sensor"].tolist())):
        rows = columns["sensor"] == name
        columns["stamp_ns"][rows] = clocks[name].message_times_ns(
            columns["stamp_ns"][rows], columns["log_time_ns"][rows]
        )
    return columns


def median_rate_hz(stamps_ns):
    """Hz from stamps t, ns; 0 where there is none."""
    steps = np.diff(stamps_ns) / NS_PER_S
    return float(1 / np.median(steps)) if len(steps) and np.median(steps) > 0 else 0.0
