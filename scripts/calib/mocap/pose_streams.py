"""Streams of poses of motion capture, by topic and frame."""

from array import array
from collections.abc import Collection, Iterable

import numpy as np

from calib.geometry.frame_graph import Edge
from calib.io.logs.log_message import LogMessage
from calib.io.parquet_tables import Columns
from calib.io.safe_names import NameGate
from calib.mocap.messages.body_pose import MocapPose
from calib.mocap.messages.pose_messages import read_poses


class PoseStream:
    """Poses of one frame in another, in the order of the log."""

    def __init__(self) -> None:
        self._stamps_ns, self._log_times_ns, self._values = array("q"), array("q"), array("d")

    def add_pose(self, pose: MocapPose, log_time_ns: int) -> None:
        """Add a pose, with the log time of its message."""
        self._stamps_ns.append(-1 if pose.stamp_ns is None else pose.stamp_ns)
        self._log_times_ns.append(log_time_ns)
        self._values.extend((*pose.xyz, *pose.quat))

    def columns(self) -> Columns:
        """Return stamp_ns, log_time_ns (n,), xyz (n, 3) and quat (n, 4) in log order.

        A missing stamp is -1. The arrays are views, so that an hour of poses is in memory once.
        """
        values = np.frombuffer(self._values).reshape(-1, 7)
        return {
            "stamp_ns": np.frombuffer(self._stamps_ns, np.int64),
            "log_time_ns": np.frombuffer(self._log_times_ns, np.int64),
            "xyz": values[:, :3],
            "quat": values[:, 3:],
        }


class MocapStreams:
    """The streams that may be needed to place bodies in the map.

    These are the streams of bodies in the map, of the wanted bodies, and of the frames that these
    are given in. body_by_topic: {topic: body}, None if the message names it; parents_by_body:
    {body: frames that it was given in}; names: the gate of the log.
    """

    def __init__(
        self,
        map_frame: str,
        bodies: Collection[str],
        body_by_topic: dict[str, str | None],
        names: NameGate,
    ) -> None:
        self.map_frame, self.body_by_topic, self.bodies = map_frame, body_by_topic, bodies
        self._wanted_frames, self._names = set(bodies), names
        self._streams: dict[tuple[str, Edge], PoseStream] = {}
        self.parents_by_body: dict[str, set[str]] = {}

    @property
    def wanted_frames(self) -> frozenset[str]:
        """The wanted bodies, and the frames that they are given in."""
        return frozenset(self._wanted_frames)

    def add_parent_frames(self, static_edges: Iterable[Edge]) -> None:
        """Also keep the streams of frames that carry bodies through static edges."""
        parents = {child: parent for parent, child in static_edges}
        for body in self.bodies:
            while body in parents and parents[body] not in self._wanted_frames:
                body = parents[body]
                self._wanted_frames.add(body)

    def add_message(self, message: LogMessage) -> None:
        """Add the poses of a message; raises InputError if it cannot be read."""
        topic_body = self.body_by_topic.get(message.topic)
        for pose in read_poses(message, self._names):
            body = pose.body if pose.is_multi_body else topic_body or pose.body or message.topic
            parent = pose.parent or self.map_frame
            self.parents_by_body.setdefault(body, set()).add(parent)
            if body in self._wanted_frames:
                self._wanted_frames.add(parent)
            if body in self._wanted_frames or parent == self.map_frame:
                key = message.topic, (parent, body)
                self._streams.setdefault(key, PoseStream()).add_pose(pose, message.log_time_ns)

    def topics_by_frame(self) -> dict[str, list[str]]:
        """Return {frame: topics with its poses}, in order."""
        out: dict[str, list[str]] = {}
        for topic, (_, child) in sorted(self._streams):
            out.setdefault(child, []).append(topic)
        return out

    def columns_by_topic(self) -> dict[str, dict[Edge, Columns]]:
        """Return {topic: {(parent, child): columns}}, both in order."""
        out: dict[str, dict[Edge, Columns]] = {}
        for (topic, edge), stream in sorted(self._streams.items()):
            out.setdefault(topic, {})[edge] = stream.columns()
        return out
