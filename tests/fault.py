"""One fault of a recording or of what is written about it, and helpers to make it.

Rows are the messages of a recording: (log time in ns, topic, type, message of ROS 2).
"""

from typing import NamedTuple

import numpy as np

from simulation import ros_log
from simulation.world.smooth_motion import START_NS

MS, S = 10**6, 10**9
POSES, CLOUDS, IMAGES, INFO = "/tf", "/velodyne_points", "/camera/image_raw", "/camera/camera_info"
ROBOT, BOARD, CYLINDER = "mocap/robot", "mocap/board", "mocap/cylinder"


class Fault(NamedTuple):
    """what: in words; says: part of the sentence by which it is told.

    damage: rows -> rows of the log; simulated: arguments of simulate.py beyond those of the clean
    log; write: function of (path without suffix, rows) that gives the log as config.yaml names it,
    None for one MCAP; spoil: bytes of that MCAP -> bytes; config: function that changes the
    config's (session, rig, {target: its file}); note: what has to be known of what comes of it.
    """

    what: str
    says: str
    damage: object = None
    simulated: str = ""
    write: object = None
    spoil: object = None
    config: object = None
    note: str = ""


def on(topic, change):
    """A damage that calls change(message, number) on every message of a topic."""

    def damage(rows):
        for number, row in enumerate(r for r in rows if r[1] == topic):
            change(row[3], number)
        return rows

    return damage


def without(wanted):
    """A damage that leaves out those rows of which wanted(row, number in its topic) holds."""

    def damage(rows):
        count, out = {}, []
        for row in rows:
            number = count[row[1]] = count.get(row[1], -1) + 1
            if not wanted(row, number):
                out.append(row)
        return out

    return damage


def times(first_s, length_s, every_s=2.9):
    """A function of a time, s since the first placement, whether it lies in the first of spans that
    come again and again: 2.9 s is two placements and a bit, so that rests and moves are hit."""
    return lambda t: t >= first_s and (t - first_s) % every_s < length_s


def stamp_ns(header):
    return header.stamp.sec * S + header.stamp.nanosec


def set_stamp(header, t):
    """Set the stamp of a header to t, ns."""
    header.stamp.sec, header.stamp.nanosec = int(t // S), int(t % S)


def seconds(header):
    """Time of a header, s since the first placement."""
    return (stamp_ns(header) - START_NS) / S


# --- clouds


def points(message):
    """The points of a PointCloud2 as a structured array (n,)."""
    names = {v: k for k, v in ros_log.NUMPY_TO_FIELD.items()}
    order = ">" if message.is_bigendian else "<"
    layout = np.dtype(
        {
            "names": [f.name for f in message.fields],
            "formats": [np.dtype(names[f.datatype]).newbyteorder(order) for f in message.fields],
            "offsets": [f.offset for f in message.fields],
            "itemsize": message.point_step,
        }
    )
    return np.asarray(message.data, np.uint8).view(layout).copy()


def put(message, array, height=1):
    """Put points (n,) of any layout into a PointCloud2."""
    layout = array.dtype
    message.fields = [
        ros_log.STORE.types["sensor_msgs/msg/PointField"](
            name=name,
            offset=layout.fields[name][1],
            datatype=ros_log.NUMPY_TO_FIELD[layout[name].newbyteorder("=").name],
            count=1,
        )
        for name in layout.names
    ]
    message.height, message.width = height, len(array) // height
    message.point_step = layout.itemsize
    message.row_step = message.width * layout.itemsize
    message.data = np.ascontiguousarray(array).view(np.uint8).reshape(-1)


def repacked(array, fields, size=None, order="<"):
    """Points in a layout of those fields, {name: type}; of size bytes each, the last of them
    padding."""
    formats = [np.dtype(t).newbyteorder(order) for t in fields.values()]
    ends = np.cumsum([f.itemsize for f in formats]).tolist()
    layout = {"names": list(fields), "formats": formats, "offsets": [0, *ends[:-1]]}
    out = np.zeros(len(array), np.dtype(layout | {"itemsize": size or ends[-1]}))
    for name in fields:
        out[name] = array[name]
    return out


def clouds(change):
    """A damage that puts change(points, number) in place of the points of every cloud."""
    return on(CLOUDS, lambda message, number: put(message, change(points(message), number)))


# --- poses


def transforms(change, body=None, when=lambda t: True):
    """A damage that calls change(transform, number) for the poses of a body (None: all) at those
    times."""

    def of_message(message, number):
        for item in message.transforms:
            mine = body is None or item.child_frame_id == body
            if mine and when(seconds(item.header)):
                change(item, number)

    return on(POSES, of_message)


def moved(item, dx=0.0, dy=0.0, dz=0.0):
    p = item.transform.translation
    p.x, p.y, p.z = p.x + dx, p.y + dy, p.z + dz


def quaternion(item, *xyzw):
    q = item.transform.rotation
    q.x, q.y, q.z, q.w = xyzw


def xyzw(item):
    q = item.transform.rotation
    return q.x, q.y, q.z, q.w
