"""What a log holds, read in one pass: poses, one row per sensor message, and an audit of both."""

import difflib
from fnmatch import fnmatchcase

import numpy as np

from calib import hearing, mocap, stamps, tables
from calib.cameras import info
from calib.status import OK, failed

NS = mocap.NS
POSES = ("tf2_msgs/msg/TFMessage",)


class Recording:
    """Rows of mocap.parquet and frames.parquet as they come, static transforms, and frame ids."""

    def __init__(self, sensors, map_frame):
        self.sensors, self.map_frame = sensors, map_frame
        self._name_of = {s["topic"]: name for name, s in sorted(sensors.items())}
        self.poses, self.frames, self.static, self.frame_ids = [], [], {}, {}
        self.heard = {name: hearing.KINDS[s["kind"]](s) for name, s in sensors.items()}

    def take(self, message):
        """Add what one message says."""
        if message.topic in self._name_of:
            self._frame(message, self._name_of[message.topic])
        elif message.type == info.TYPE:
            self._info(message)
        elif message.topic == "/tf_static":
            self._static(message)
        elif message.type in POSES:
            self._poses(message)

    def _frame(self, message, name):
        if message.type in self.heard[name].types:
            content = message.content
            self.frame_ids.setdefault(name, stamps.frame_id(content))
            place = (message.log_t, len(message.data), message.file, message.ordinal)
            self.frames.append((name, stamps.stamp_ns(content), *place))
            self.heard[name].take(content, message.log_t)

    def _info(self, message):
        for name, sensor in self.sensors.items():
            if sensor.get("camera_info") == message.topic:
                self.heard[name].take_info(message.content)

    def _static(self, message):
        for item in message.content.transforms:
            xyz, quat = _pose(item.transform)
            edge = item.header.frame_id, item.child_frame_id
            self.static[edge] = {"xyz_m": list(xyz), "quat_xyzw": list(quat)}

    def _poses(self, message):
        for item in message.content.transforms:
            if item.header.frame_id == self.map_frame:
                t = stamp_ns(item.header)
                self.poses.append((item.child_frame_id, t, message.log_t, *_pose(item.transform)))


def stamp_ns(header):
    """The stamp of a ROS header, ns."""
    return header.stamp.sec * NS + header.stamp.nanosec


def _pose(transform):
    p, q = transform.translation, transform.rotation
    return (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)


def read(log, options):
    """The Recording of a log, within from_s and to_s after its first message."""
    recording = Recording(options["sensors"], options["mocap"]["map"])
    sensors = options["sensors"].values()
    infos = [s["camera_info"] for s in sensors if "camera_info" in s]
    topics = (*options["mocap"]["topics"], *(s["topic"] for s in sensors), *infos)
    wanted = sorted({t for t in (*topics, "/tf_static") if t in log.topics})
    for message in log.messages(wanted, *_bounds(log, options)):
        recording.take(message)
    return recording


def _bounds(log, options):
    """First and last log time, ns, that from_s and to_s allow; None where they are not given."""
    return [
        None if options[k] is None else log.start + round(options[k] * NS)
        for k in ("from_s", "to_s")
    ]


def pose_columns(poses):
    """Columns of mocap.parquet: bodies by name, poses in log order, each with its fault."""
    if not poses:
        return tables.empty(tables.MOCAP)
    body, t, log_t, xyz, quat = (np.array(c) for c in zip(*poses, strict=True))
    order = np.argsort(body, kind="stable")
    columns = {
        "body": body,
        "t": t,
        "log_t": log_t,
        "xyz": xyz.astype(float),
        "quat": quat.astype(float),
    }
    columns = {k: v[order] for k, v in columns.items()}
    fault = [
        mocap.faults(*(columns[k][columns["body"] == name] for k in ("t", "xyz", "quat")))
        for name in sorted(set(body.tolist()))
    ]
    return columns | {"fault": np.concatenate(fault)}


def frame_columns(frames):
    """Columns of frames.parquet: sensors by name, messages by place in the log."""
    if not frames:
        return tables.empty(tables.FRAMES)
    frames = sorted(frames, key=lambda f: (f[0], f[4], f[2], f[5]))
    return dict(zip(tables.FRAMES.names, zip(*frames, strict=True), strict=True))


def _rate(t):
    """Hz from stamps t, ns; 0 where there is none."""
    steps = np.diff(t) / NS
    return float(1 / np.median(steps)) if len(steps) and np.median(steps) > 0 else 0.0


def body_audit(columns, name):
    """Count, rate, longest gap and faults of one body, with a status."""
    bodies = np.asarray(columns["body"], str)
    rows = bodies == name
    if not rows.any():
        return {"status": _unseen(name, sorted(set(bodies.tolist()))).to_dict(), "poses": 0}
    fault = columns["fault"][rows]
    t = columns["t"][rows][fault == ""]
    kinds, counts = np.unique(fault[fault != ""], return_counts=True)
    return {
        "status": OK.to_dict(),
        "poses": int(rows.sum()),
        "faults": dict(zip(kinds.tolist(), counts.tolist(), strict=True)),
        "rate_hz": _rate(t),
        "longest_gap_s": float(np.diff(t).max() / NS) if len(t) > 1 else 0.0,
    }


def _unseen(name, seen):
    near = difflib.get_close_matches(name, seen, 1)
    remedy = "check `body`, `mocap.topics` and `mocap.map`, the parent frame of the poses"
    return failed(
        f"MCS body {name} is not in the log",
        f"bodies {', '.join(seen) or 'none'}",
        name,
        f"did you mean {near[0]}?" if near else remedy,
    )


def sensor_audit(name, recording, topics, columns):
    """Count, rate and frame of one sensor, what its messages tell (hearing), and a status; topics:
    of the log, with their types."""
    rows = np.asarray(columns["sensor"]) == name
    t, heard = np.asarray(columns["t"])[rows], recording.heard[name]
    status, rate, told = _heard(recording.sensors[name], topics, len(t)), _rate(t), {}
    if status.ok:
        told, status = heard.told(NS / rate if rate else 0, topics)
    return told | {
        "status": status.to_dict(),
        "frame": recording.frame_ids.get(name, ""),
        "messages": len(t),
        "rate_hz": rate,
    }


def _heard(sensor, topics, messages):
    """Ok, or why a sensor's topic gives nothing."""
    topic, kind = sensor["topic"], hearing.KINDS[sensor["kind"]]
    if topic not in topics:
        near = difflib.get_close_matches(topic, topics, 1)
        remedy = f"did you mean {near[0]}?" if near else "check the sensor's `topic`"
        found = ", ".join(sorted(topics)) or "no topic at all"
        return failed(f"topic {topic} is not in the log", found, topic, remedy)
    if topics[topic][0] not in kind.types:
        return _another_type(sensor, kind, topics[topic][0])
    if messages == 0:
        return failed(f"topic {topic} has no message", "0", "1 or more", "Check from_s and to_s.")
    return OK


def _another_type(sensor, kind, found):
    """Why a type is not read, with what to do where it is known."""
    known = [remedy for pattern, remedy in kind.refused.items() if fnmatchcase(found, pattern)]
    return failed(
        f"topic {sensor['topic']} carries another type",
        found,
        " or ".join(kind.types),
        known[0] if known else f"Name the {sensor['kind']}'s topic, or record it in that type.",
    )
