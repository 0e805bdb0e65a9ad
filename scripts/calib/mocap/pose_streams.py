"""Streams of poses, by topic and frame."""

from array import array

import numpy as np

from calib.mocap.messages.pose_messages import read_poses


class PoseStream:
    """Poses of one frame in another, as they come."""

    def __init__(self):
        self._stamps_ns, self._log_times_ns, self._values = array("q"), array("q"), array("d")

    def add_pose(self, stamp_ns, log_time_ns, xyz, quat):
        """Add one pose; t None where it has no stamp."""
        self._stamps_ns.append(-1 if stamp_ns is None else stamp_ns)
        self._log_times_ns.append(log_time_ns)
        self._values.extend((*xyz, *quat))

    def columns(self):
        """{t, log_t (n,) ns, xyz (n, 3), quat (n, 4)} in log order, t -1 where there is none; no
        copies, so that an hour of poses stands in memory once."""
        values = np.frombuffer(self._values).reshape(-1, 7)
        t, log_t = (
            np.frombuffer(self._stamps_ns, np.int64),
            np.frombuffer(self._log_times_ns, np.int64),
        )
        return {"stamp_ns": t, "log_time_ns": log_t, "xyz": values[:, :3], "quat": values[:, 3:]}


class MocapStreams:
    """Every stream that may place a body in the map: those in it, and those of the bodies wanted
    and of the frames that they are given in.

    names: topic -> body, None or absent where the message names it.
    """

    def __init__(self, map_frame, bodies, body_by_topic):
        self.map_frame, self.body_by_topic, self.bodies = map_frame, body_by_topic, bodies
        self._wanted_frames = set(bodies)
        self._streams = {}
        self.parents_by_body = {}  # body -> frames that it was given in

    def add_parent_frames(self, static_edges):
        """Take also what places the frames that static edges (parent, child) hold the bodies in."""
        parents = {child: parent for parent, child in static_edges}
        for body in self.bodies:
            while body in parents and parents[body] not in self._wanted_frames:
                body = parents[body]
                self._wanted_frames.add(body)

    def add_message(self, message):
        """Add what a message of motion capture says; raises InputError where it cannot be read."""
        named = self.body_by_topic.get(message.topic)
        for pose in read_poses(message):
            body = pose.body if pose.is_multi_body else named or pose.body or message.topic
            parent = pose.parent or self.map_frame
            self.parents_by_body.setdefault(body, set()).add(parent)
            if body in self._wanted_frames:
                self._wanted_frames.add(parent)
            if body in self._wanted_frames or parent == self.map_frame:
                place = message.topic, (parent, body)
                stream = self._streams.setdefault(place, PoseStream())
                stream.add_pose(pose.stamp_ns, message.log_time_ns, pose.xyz, pose.quat)

    def topics_by_frame(self):
        """{frame: topics that gave it, in order}."""
        out = {}
        for topic, (_, child) in sorted(self._streams):
            out.setdefault(child, []).append(topic)
        return out

    def columns_by_topic(self):
        """{topic: {(parent, child): columns}}, both in order."""
        out = {}
        for (topic, edge), stream in sorted(self._streams.items()):
            out.setdefault(topic, {})[edge] = stream.columns()
        return out
