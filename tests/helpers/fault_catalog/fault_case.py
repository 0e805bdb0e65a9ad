"""One fault of a recording or of what is written about it, and helpers to make it.

Rows are the messages of a recording: (log time in ns, topic, type, message of ROS 2).
"""

from typing import NamedTuple

import numpy as np

from calib.geometry.units import NS_PER_S
from calib.io.logs import ros_messages
from calib.io.logs.ros_messages import NUMPY_TO_POINT_FIELD
from simulation.world.smooth_motion import SIMULATION_START_NS

NS_PER_MS = 10**6
TF_TOPIC, CLOUD_TOPIC, IMAGE_TOPIC, CAMERA_INFO_TOPIC = (
    "/tf",
    "/velodyne_points",
    "/camera/image_raw",
    "/camera/camera_info",
)
ROBOT_BODY, BOARD_BODY, CYLINDER_BODY = "mocap/robot", "mocap/board", "mocap/cylinder"


class FaultCase(NamedTuple):
    """what: in words; says: part of the sentence by which it is told.

    damage: rows -> rows of the log; simulated: arguments of simulate.py beyond those of the clean
    log; write: function of (path without suffix, rows) that gives the log as config.yaml names it,
    None for one MCAP; spoil: bytes of that MCAP -> bytes; config: function that changes the
    config's (session, rig, {target: its file}); note: what has to be known of what comes of it.
    """

    description: str
    expected_text: str
    damage_rows: object = None
    simulate_arguments: str = ""
    write_log: object = None
    damage_bytes: object = None
    change_config: object = None
    note: str = ""


def damage_topic(topic, change_message):
    """A damage that calls change(message, number) on every message of a topic."""

    def damage(rows):
        for number, row in enumerate(r for r in rows if r[1] == topic):
            change_message(row[3], number)
        return rows

    return damage


def drop_rows(is_dropped):
    """A damage that leaves out those rows of which wanted(row, number in its topic) holds."""

    def damage(rows):
        count, out = {}, []
        for row in rows:
            number = count[row[1]] = count.get(row[1], -1) + 1
            if not is_dropped(row, number):
                out.append(row)
        return out

    return damage


def make_time_filter(first_s, length_s, every_s=2.9):
    """A function of a time, s since the first placement, whether it lies in the first of spans that
    come again and again: 2.9 s is two placements and a bit, so that rests and moves are hit."""
    return lambda t: t >= first_s and (t - first_s) % every_s < length_s


def read_header_stamp(header):
    return header.stamp.sec * NS_PER_S + header.stamp.nanosec


def set_header_stamp(header, t):
    """Set the stamp of a header to t, ns."""
    header.stamp.sec, header.stamp.nanosec = int(t // NS_PER_S), int(t % NS_PER_S)


def seconds_since_start(header):
    """Time of a header, s since the first placement."""
    return (read_header_stamp(header) - SIMULATION_START_NS) / NS_PER_S


# --- clouds


def read_cloud_points(message):
    """The points of a PointCloud2 as a structured array (n,)."""
    names = {v: k for k, v in NUMPY_TO_POINT_FIELD.items()}
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


def set_cloud_points(message, array, height=1):
    """Put points (n,) of any layout into a PointCloud2."""
    layout = array.dtype
    message.fields = [
        ros_messages.ROS2_TYPES.types["sensor_msgs/msg/PointField"](
            name=name,
            offset=layout.fields[name][1],
            datatype=NUMPY_TO_POINT_FIELD[layout[name].newbyteorder("=").name],
            count=1,
        )
        for name in layout.names
    ]
    message.height, message.width = height, len(array) // height
    message.point_step = layout.itemsize
    message.row_step = message.width * layout.itemsize
    message.data = np.ascontiguousarray(array).view(np.uint8).reshape(-1)


def repack_points(array, fields, size=None, byte_order="<"):
    """Points in a layout of those fields, {name: type}; of size bytes each, the last of them
    padding."""
    formats = [np.dtype(t).newbyteorder(byte_order) for t in fields.values()]
    ends = np.cumsum([f.itemsize for f in formats]).tolist()
    layout = {"names": list(fields), "formats": formats, "offsets": [0, *ends[:-1]]}
    out = np.zeros(len(array), np.dtype(layout | {"itemsize": size or ends[-1]}))
    for name in fields:
        out[name] = array[name]
    return out


def damage_clouds(change_points):
    """A damage that puts change(points, number) in place of the points of every cloud."""
    return damage_topic(
        CLOUD_TOPIC,
        lambda message, number: set_cloud_points(
            message, change_points(read_cloud_points(message), number)
        ),
    )


# --- poses


def damage_transforms(change_transform, body=None, is_affected=lambda t: True):
    """A damage that calls change(transform, number) for the poses of a body (None: all) at those
    times."""

    def of_message(message, number):
        for item in message.transforms:
            mine = body is None or item.child_frame_id == body
            if mine and is_affected(seconds_since_start(item.header)):
                change_transform(item, number)

    return damage_topic(TF_TOPIC, of_message)


def shift_transform(item, dx=0.0, dy=0.0, dz=0.0):
    p = item.transform.translation
    p.x, p.y, p.z = p.x + dx, p.y + dy, p.z + dz


def set_quaternion(item, *xyzw):
    q = item.transform.rotation
    q.x, q.y, q.z, q.w = xyzw


def read_quaternion(item):
    q = item.transform.rotation
    return q.x, q.y, q.z, q.w
