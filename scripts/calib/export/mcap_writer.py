"""MCAP files with ROS 2 messages: the same bytes for the same messages."""

import io

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from calib.geometry import se3

STORE = get_typestore(Stores.ROS2_HUMBLE)
LIBRARY = "calibration export"
TF = "tf2_msgs/msg/TFMessage"
# As rosbag2 writes them: the last message is kept for whoever subscribes later.
LATCHED = """\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""
QOS = {"/tf_static": LATCHED}


def make(name, /, **fields):
    """A message of a type."""
    return STORE.types[name](**fields)


def header(t, frame):
    """std_msgs/msg/Header of a time, ns, and a frame."""
    stamp = make("builtin_interfaces/msg/Time", sec=int(t // 10**9), nanosec=int(t % 10**9))
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def transforms(t, edges):
    """(t, topic, type, message) of static transforms (scene.Edge), stamped t, ns."""
    items = []
    for edge in edges:
        quat = dict(zip("xyzw", se3.to_quat(edge.T).tolist(), strict=True))
        xyz = dict(zip("xyz", edge.T[:3, 3].tolist(), strict=True))
        pose = make(
            "geometry_msgs/msg/Transform",
            translation=make("geometry_msgs/msg/Vector3", **xyz),
            rotation=make("geometry_msgs/msg/Quaternion", **quat),
        )
        stamped = {"header": header(t, edge.parent), "child_frame_id": edge.child}
        items.append(make("geometry_msgs/msg/TransformStamped", **stamped, transform=pose))
    return t, "/tf_static", TF, make(TF, transforms=items)


def cloud(t, frame, xyz, bgr):
    """sensor_msgs/msg/PointCloud2 of xyz (n, 3), m, in colours bgr (n, 3) uint8."""
    layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
    points = np.zeros(len(xyz), layout)
    for axis, key in enumerate("xyz"):
        points[key] = xyz[:, axis]
    b, g, r = np.asarray(bgr, np.uint32).reshape(-1, 3).T
    points["rgb"] = r << 16 | g << 8 | b
    fields = [
        make("sensor_msgs/msg/PointField", name=n, offset=4 * i, datatype=7, count=1)
        for i, n in enumerate(layout.names)
    ]
    return make(
        "sensor_msgs/msg/PointCloud2",
        header=header(t, frame),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=layout.itemsize,
        row_step=points.nbytes,
        data=points.view("u1"),
        is_dense=True,
    )


def to_bytes(messages, about):
    """The MCAP of messages (time in ns, topic, type, message), sorted by time; about: {key: text},
    kept as its metadata `calibration`."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library=LIBRARY)
    writer.add_metadata("calibration", about)
    schemas, channels, counts = {}, {}, {}
    for t, topic, name, message in sorted(messages, key=lambda m: m[:2]):
        if name not in schemas:
            text = STORE.generate_msgdef(name, ros_version=2)[0].encode()
            schemas[name] = writer.register_schema(name, "ros2msg", text)
        if topic not in channels:
            qos = {"offered_qos_profiles": QOS.get(topic, "")}
            channels[topic] = writer.register_channel(topic, "cdr", schemas[name], qos)
        counts[topic] = counts.get(topic, 0) + 1
        data = bytes(STORE.serialize_cdr(message, name))
        writer.add_message(channels[topic], int(t), data, int(t), counts[topic])
    writer.finish()
    return stream.getvalue()
