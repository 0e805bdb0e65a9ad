"""Streams of poses, by topic and frame."""

from array import array

import numpy as np

from calib.mocap.messages import pose_messages


class Stream:
    """Poses of one frame in another, as they come."""

    def __init__(self):
        self._t, self._log_t, self._values = array("q"), array("q"), array("d")

    def add(self, t, log_t, xyz, quat):
        """Add one pose; t None where it has no stamp."""
        self._t.append(-1 if t is None else t)
        self._log_t.append(log_t)
        self._values.extend((*xyz, *quat))

    def columns(self):
        """{t, log_t (n,) ns, xyz (n, 3), quat (n, 4)} in log order, t -1 where there is none; no
        copies, so that an hour of poses stands in memory once."""
        values = np.frombuffer(self._values).reshape(-1, 7)
        t, log_t = np.frombuffer(self._t, np.int64), np.frombuffer(self._log_t, np.int64)
        return {"t": t, "log_t": log_t, "xyz": values[:, :3], "quat": values[:, 3:]}


class Streams:
    """Every stream that may place a body in the map: those in it, and those of the bodies wanted
    and of the frames that they are given in.

    names: topic -> body, None or absent where the message names it.
    """

    def __init__(self, map_frame, bodies, names):
        self.map, self.names, self.bodies = map_frame, names, bodies
        self._wanted = set(bodies)
        self._found = {}
        self.parents = {}  # body -> frames that it was given in

    def want_parents(self, static):
        """Take also what places the frames that static edges (parent, child) hold the bodies in."""
        parents = {child: parent for parent, child in static}
        for body in self.bodies:
            while body in parents and parents[body] not in self._wanted:
                body = parents[body]
                self._wanted.add(body)

    def take(self, message):
        """Add what a message of motion capture says; raises InputError where it cannot be read."""
        named = self.names.get(message.topic)
        for pose in pose_messages.poses(message):
            body = pose.body if pose.several else named or pose.body or message.topic
            parent = pose.parent or self.map
            self.parents.setdefault(body, set()).add(parent)
            if body in self._wanted:
                self._wanted.add(parent)
            if body in self._wanted or parent == self.map:
                place = message.topic, (parent, body)
                stream = self._found.setdefault(place, Stream())
                stream.add(pose.t, message.log_t, pose.xyz, pose.quat)

    def topics(self):
        """{frame: topics that gave it, in order}."""
        out = {}
        for topic, (_, child) in sorted(self._found):
            out.setdefault(child, []).append(topic)
        return out

    def by_topic(self):
        """{topic: {(parent, child): columns}}, both in order."""
        out = {}
        for (topic, edge), stream in sorted(self._found.items()):
            out.setdefault(topic, {})[edge] = stream.columns()
        return out
