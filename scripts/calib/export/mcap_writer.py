"""MCAP files with ROS 2 messages: the same bytes for the same messages."""

import io

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from calib.geometry.se3 import pose_to_quat

ROS2_TYPESTORE = get_typestore(Stores.ROS2_HUMBLE)
MCAP_LIBRARY = "calibration export"
TF_MESSAGE_TYPE = "tf2_msgs/msg/TFMessage"
# As rosbag2 writes them: the last message is kept for whoever subscribes later.
LATCHED_QOS = """\
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
QOS_BY_TOPIC = {"/tf_static": LATCHED_QOS}


def make_ros_message(name, /, **fields):
    """A message of a type."""
    return ROS2_TYPESTORE.types[name](**fields)


def make_ros_header(t, frame):
    """std_msgs/msg/Header of a time, ns, and a frame."""
    stamp = make_ros_message(
        "builtin_interfaces/msg/Time", sec=int(t // 10**9), nanosec=int(t % 10**9)
    )
    return make_ros_message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def make_static_tf_message(t, static_transforms):
    """(t, topic, type, message) of static transforms (scene.Edge), stamped t, ns."""
    items = []
    for edge in static_transforms:
        quat = dict(zip("xyzw", pose_to_quat(edge.T_parent_child).tolist(), strict=True))
        xyz = dict(zip("xyz", edge.T_parent_child[:3, 3].tolist(), strict=True))
        pose = make_ros_message(
            "geometry_msgs/msg/Transform",
            translation=make_ros_message("geometry_msgs/msg/Vector3", **xyz),
            rotation=make_ros_message("geometry_msgs/msg/Quaternion", **quat),
        )
        stamped = {"header": make_ros_header(t, edge.parent), "child_frame_id": edge.child}
        items.append(
            make_ros_message("geometry_msgs/msg/TransformStamped", **stamped, transform=pose)
        )
    return t, "/tf_static", TF_MESSAGE_TYPE, make_ros_message(TF_MESSAGE_TYPE, transforms=items)


def make_colored_cloud_message(t, frame, xyz, bgr):
    """sensor_msgs/msg/PointCloud2 of xyz (n, 3), m, in colours bgr (n, 3) uint8."""
    layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
    points = np.zeros(len(xyz), layout)
    for axis, key in enumerate("xyz"):
        points[key] = xyz[:, axis]
    b, g, r = np.asarray(bgr, np.uint32).reshape(-1, 3).T
    points["rgb"] = r << 16 | g << 8 | b
    fields = [
        make_ros_message("sensor_msgs/msg/PointField", name=n, offset=4 * i, datatype=7, count=1)
        for i, n in enumerate(layout.names)
    ]
    return make_ros_message(
        "sensor_msgs/msg/PointCloud2",
        header=make_ros_header(t, frame),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=layout.itemsize,
        row_step=points.nbytes,
        data=points.view("u1"),
        is_dense=True,
    )


def encode_mcap(messages, metadata):
    """The MCAP of messages (time in ns, topic, type, message), sorted by time; metadata: {key: text},
    kept as its metadata `calibration`."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library=MCAP_LIBRARY)
    writer.add_metadata("calibration", metadata)
    schemas, channels, counts = {}, {}, {}
    for t, topic, name, message in sorted(messages, key=lambda m: m[:2]):
        if name not in schemas:
            text = ROS2_TYPESTORE.generate_msgdef(name, ros_version=2)[0].encode()
            schemas[name] = writer.register_schema(name, "ros2msg", text)
        if topic not in channels:
            qos = {"offered_qos_profiles": QOS_BY_TOPIC.get(topic, "")}
            channels[topic] = writer.register_channel(topic, "cdr", schemas[name], qos)
        counts[topic] = counts.get(topic, 0) + 1
        data = bytes(ROS2_TYPESTORE.serialize_cdr(message, name))
        writer.add_message(channels[topic], int(t), data, int(t), counts[topic])
    writer.finish()
    return stream.getvalue()
