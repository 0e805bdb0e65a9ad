"""Streams of poses as motion capture sends them, and what has to be known to use them.

A stream is what one topic says of one frame in another. Its unit and its order of quaternions are
those of its topic, and found from all that this says.
"""

from array import array

import numpy as np

from calib import faults, mcs

FAR_M = 50.0  # no motion capture sees as far: it sends millimetres
PLANE, SPREAD_M, TURN_RAD = 0.1, 0.2, 0.5  # of a body that drives and turns on a floor
ALONG, ACROSS = 0.9, 0.5  # cosines of the axis it turns about to the floor's normal
UPRIGHT, LYING = 0.94, 0.5  # cosines of the tilt of a body that stands, and of one that does not
LOOKED_AT = 2000  # poses of a stream


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
        for pose in mcs.poses(message):
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


def standard(edges):
    """The edges of a topic in metres and xyzw, and what was found and done, in words.

    edges: {(parent, child): columns}.
    """
    words = []
    far = max(_distance(c["xyz"]) for c in edges.values())
    if far > FAR_M:
        words.append(f"millimetres, taken as such: bodies are {far:.0f} from the origin")
        edges = {k: c | {"xyz": c["xyz"] / 1000} for k, c in edges.items()}
    turns = [t for c in edges.values() if (t := _turning(c["xyz"], c["quat"])) is not None]
    if turns and all(as_sent < ACROSS and turned > ALONG for as_sent, turned, _ in turns):
        words.append("quaternions as wxyz, taken as such: as xyzw a body would roll as it drives")
        edges = {k: c | {"quat": np.roll(c["quat"], -1, axis=1)} for k, c in edges.items()}
    elif standing := [child for (_, child), c in edges.items() if _stands_as_wxyz(c)]:
        words.append(
            f"quaternions may be wxyz, taken as xyzw: {standing[0]} never stands upright, and "
            "always would as wxyz; mend what publishes them if no target is found"
        )
    if turns and all(abs(normal[1]) > ALONG for *_, normal in turns):
        words.append(
            "the y axis of the map points up: bodies drive across it; no result depends on it"
        )
    return edges, words


def _distance(xyz):
    """Median distance of positions to the origin, zeros and what is no number left out."""
    sane = (np.abs(xyz) < 1e3 * faults.MOST_M).all(1)  # neither NaN nor a wrong bit
    far = np.linalg.norm(xyz[sane], axis=1)
    far = far[far > 0]
    return float(np.median(far)) if len(far) else 0.0


def _stands_as_wxyz(columns):
    """Whether a body stands upright all the time if its quaternions are read as wxyz, and never as
    they are sent."""
    xyz, quat = columns["xyz"], columns["quat"]
    quat = quat[faults.alone(xyz, quat) == ""]
    as_sent, turned = (1 - 2 * (q[:, :2] ** 2).sum(1) for q in (quat, np.roll(quat, -1, axis=1)))
    return len(quat) > 0 and as_sent.max() < LYING and turned.min() > UPRIGHT


def _turning(xyz, quat):
    """How well the axis about which a body turns while it drives on a floor fits the floor's
    normal (cosines), its quaternions read as xyzw and as wxyz, and that normal (3,); None of a body
    that does not."""
    fine = np.flatnonzero(faults.alone(xyz, quat) == "")
    fine = fine[:: max(1, len(fine) // LOOKED_AT)]
    if len(fine) < 10:
        return None
    _, size, axes = np.linalg.svd(xyz[fine] - xyz[fine].mean(0), full_matrices=False)
    size = size / np.sqrt(len(fine))
    if size[1] < SPREAD_M or size[2] > PLANE * size[1]:
        return None
    readings = [quat[fine], np.roll(quat[fine], -1, axis=1)]
    turned = [_axis(q) for q in readings]
    if any(a is None for a in turned):
        return None
    return *(abs(float(a @ axes[2])) for a in turned), axes[2]


def _axis(quat):
    """Unit vector about which orientations differ most, in the map; None if they hardly do."""
    v, w, v0, w0 = quat[:, :3], quat[:, 3:], quat[0, :3], quat[0, 3]
    turns = w0 * v - w * v0 - np.cross(v, v0)  # vector part of q q0⁻¹
    _, size, axes = np.linalg.svd(turns, full_matrices=False)
    return axes[0] if size[0] / np.sqrt(len(turns)) > np.sin(TURN_RAD / 2) else None
