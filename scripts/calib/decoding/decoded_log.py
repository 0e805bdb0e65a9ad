"""One pass through a log: poses of motion capture, and one row per sensor message."""

from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from calib.decoding.sensor_probe import PROBE_BY_KIND
from calib.decoding.stream_clocks import StreamClock, StreamTimes, match_streams_to_log
from calib.geometry.frame_graph import Edge
from calib.geometry.units import NS_PER_S
from calib.io.logs.log_message import LogMessage
from calib.io.logs.message_headers import header_stamp_ns, read_message_header
from calib.io.logs.open_log import RecordedLog
from calib.io.parquet_tables import Columns, empty_columns
from calib.io.safe_names import NameGate
from calib.io.status import InputError, guard_message_fields
from calib.io.table_schemas import FRAMES_SCHEMA
from calib.mocap.messages.pose_messages import POSE_READERS, read_poses
from calib.mocap.pose_streams import MocapStreams
from calib.sensors.camera import camera_info_reader

TF_STATIC_TOPIC = "/tf_static"


class FrameRow(NamedTuple):
    """Row of frames.parquet: a sensor message and its place in the log; stamp_ns -1 if missing."""

    sensor: str
    stamp_ns: int
    log_time_ns: int
    size: int
    file_index: int
    index_at_log_time: int

    @property
    def place(self) -> tuple[str, int, int, int]:
        """Return the place in frames.parquet: by sensor, file and log time."""
        return self.sensor, self.file_index, self.log_time_ns, self.index_at_log_time


class DecodedLog:
    """Content of a log, filled message by message.

    streams: poses of motion capture; frame_rows: one row per sensor message; probes: {sensor: what
    its first messages show}; static_transforms: {(parent, child): pose block}; frame_ids: {sensor:
    frame of its messages}; camera_info_topics: of which there was a CameraInfo; n_unreadable,
    first_errors: {topic: number of unreadable messages} and {topic: why the first is unreadable};
    names: the gate that all names of the log pass.
    """

    def __init__(self, options: dict[str, Any], names: NameGate | None = None) -> None:
        self.sensors = options["sensors"]
        self.names = names or NameGate()
        self.streams = MocapStreams(
            map_frame=options["mocap"]["map"],
            bodies=options["bodies"],
            body_by_topic=mocap_topics(options["mocap"]),
            names=self.names,
        )
        self._sensor_by_topic = {s["topic"]: name for name, s in sorted(self.sensors.items())}
        self.probes = {name: PROBE_BY_KIND[s["kind"]](s) for name, s in self.sensors.items()}
        self.frame_rows: list[FrameRow] = []
        self.static_transforms: dict[Edge, dict[str, Any]] = {}
        self.frame_ids: dict[str, str] = {}
        self.camera_info_topics: set[str] = set()
        self.n_unreadable: Counter[str] = Counter()
        self.first_errors: dict[str, str] = {}

    def add_message(self, message: LogMessage) -> None:
        """Add the content of one message."""
        try:
            with guard_message_fields(message.type):
                self._sort_message(message)
        except InputError as error:
            self.n_unreadable[message.topic] += 1
            self.first_errors.setdefault(message.topic, str(error))

    def _sort_message(self, message: LogMessage) -> None:
        if message.topic in self._sensor_by_topic:
            self._add_frame(message, self._sensor_by_topic[message.topic])
        elif message.type == camera_info_reader.CAMERA_INFO_TYPE:
            self._add_camera_info(message)
        elif message.topic == TF_STATIC_TOPIC and message.type in POSE_READERS:
            self._add_static_transforms(message)
        elif message.type in POSE_READERS:
            self.streams.add_message(message)

    def _add_frame(self, message: LogMessage, name: str) -> None:
        if message.type not in self.probes[name].message_types:
            return
        header = read_message_header(message)
        self.frame_ids.setdefault(name, self.names.admit(header.frame_id))
        row = FrameRow(
            sensor=name,
            stamp_ns=header_stamp_ns(header) or -1,
            log_time_ns=message.log_time_ns,
            size=len(message.data),
            file_index=message.file_index,
            index_at_log_time=message.index_at_log_time,
        )
        self.frame_rows.append(row)
        self.probes[name].add_message(message)

    def _add_camera_info(self, message: LogMessage) -> None:
        self.camera_info_topics.add(message.topic)
        for name, sensor in self.sensors.items():
            if sensor.get("camera_info") == message.topic:
                self.probes[name].add_camera_info(message.content)

    def _add_static_transforms(self, message: LogMessage) -> None:
        for pose in read_poses(message, self.names):
            edge = pose.parent, pose.body
            if not np.isfinite([*pose.xyz, *pose.quat]).all():
                raise InputError(f"the transform from {edge[0]} to {edge[1]} is not finite")
            self.static_transforms[edge] = {"xyz_m": list(pose.xyz), "quat_xyzw": list(pose.quat)}


def mocap_topics(mocap_config: dict[str, Any]) -> dict[str, str | None]:
    """Return {topic: body that it names, or None} of a rig's block `mocap`."""
    topics = mocap_config["topics"]
    return dict(topics) if isinstance(topics, dict) else dict.fromkeys(topics)


def decode_log(log: RecordedLog, options: dict[str, Any]) -> DecodedLog:
    """Read a log once, from from_s to to_s after its first message.

    Static transforms are read first, and also from before from_s: they are sent only once, and they
    tell which frames are needed. So is a CameraInfo of which there is none after from_s.
    """
    decoded, sensors = DecodedLog(options, log.names), options["sensors"].values()
    camera_infos = {s["camera_info"] for s in sensors if "camera_info" in s}
    topics = {*mocap_topics(options["mocap"]), *(s["topic"] for s in sensors), *camera_infos}
    start_ns, end_ns = _log_time_bounds(log, options)
    if TF_STATIC_TOPIC in log.topics:
        for message in log.iter_messages([TF_STATIC_TOPIC], None, end_ns):
            decoded.add_message(message)
        decoded.streams.add_parent_frames(decoded.static_transforms)
    wanted = sorted(t for t in topics if t in log.topics and t != TF_STATIC_TOPIC)
    for message in log.iter_messages(wanted, start_ns, end_ns):
        decoded.add_message(message)
    if start_ns is not None:
        latched = camera_infos & set(log.topics) - decoded.camera_info_topics
        for message in _last_messages(log, sorted(latched), start_ns):
            decoded.add_message(message)
    return decoded


def _last_messages(log: RecordedLog, topics: list[str], end_ns: int) -> list[LogMessage]:
    """Return the last message of each topic before end_ns, ns."""
    messages = log.iter_messages(topics, None, end_ns) if topics else ()
    last = {message.topic: message for message in messages}
    return [last[topic] for topic in topics if topic in last]


def _log_time_bounds(log: RecordedLog, options: dict[str, Any]) -> tuple[int | None, int | None]:
    """Return the log times, ns, of from_s and to_s; None if not set."""
    start_ns, end_ns = (
        None if options[k] is None else log.start_ns + round(options[k] * NS_PER_S)
        for k in ("from_s", "to_s")
    )
    return start_ns, end_ns


def infer_stream_clocks(decoded: DecodedLog) -> dict[str, StreamClock]:
    """Return the clock of each topic of motion capture and of each sensor, by name."""
    streams = {}
    for topic, edges in decoded.streams.columns_by_topic().items():
        longest = max(edges.values(), key=lambda c: len(c["stamp_ns"]))
        streams[topic] = StreamTimes(longest["stamp_ns"], longest["log_time_ns"])
    for name in sorted(decoded.sensors):
        times = [(r.stamp_ns, r.log_time_ns) for r in decoded.frame_rows if r.sensor == name]
        if times:
            streams[name] = StreamTimes(*np.array(times, np.int64).T)
    return match_streams_to_log(streams)


def build_frame_columns(frame_rows: list[FrameRow], clocks: dict[str, StreamClock]) -> Columns:
    """Return the columns of frames.parquet: by sensor, then by place in the log."""
    if not frame_rows:
        return empty_columns(FRAMES_SCHEMA)
    rows = sorted(frame_rows, key=lambda r: r.place)
    columns = {name: np.array([getattr(r, name) for r in rows]) for name in FRAMES_SCHEMA.names}
    for name in sorted(set(columns["sensor"].tolist())):
        is_sensor = columns["sensor"] == name
        columns["stamp_ns"][is_sensor] = clocks[name].message_times_ns(
            columns["stamp_ns"][is_sensor], columns["log_time_ns"][is_sensor]
        )
    return columns


def median_rate_hz(stamps_ns: np.ndarray) -> float:
    """Return the median rate, Hz, of stamps (n,), ns; 0 if there is none."""
    steps = np.diff(stamps_ns) / NS_PER_S
    return float(1 / np.median(steps)) if len(steps) and np.median(steps) > 0 else 0.0
