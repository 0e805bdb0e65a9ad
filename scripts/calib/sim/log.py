"""ROS 2 messages and the MCAP file that holds them, the same bytes for the same messages."""

from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from calib.geometry import to_quat
from calib.sim.lidar import POINT

STORE = get_typestore(Stores.ROS2_HUMBLE)
CHUNK_BYTES = 1_000_000
TF, CLOUD, IMAGE = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image"
NUMPY_TO_FIELD = {"uint16": 4, "float32": 7}


def _make(name, /, **fields):
    return STORE.types[name](**fields)


def _header(t, frame):
    stamp = _make("builtin_interfaces/msg/Time", sec=int(t // 10**9), nanosec=int(t % 10**9))
    return _make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def transforms(t, parent, T_parent_child):
    """TFMessage of the poses T_parent_child (4, 4) by child frame, all stamped t, ns."""
    items = []
    for child, T in T_parent_child.items():
        x, y, z, w = (float(c) for c in to_quat(T))
        xyz = dict(zip("xyz", (float(c) for c in T[:3, 3]), strict=True))
        transform = _make(
            "geometry_msgs/msg/Transform",
            translation=_make("geometry_msgs/msg/Vector3", **xyz),
            rotation=_make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        )
        items.append(
            _make(
                "geometry_msgs/msg/TransformStamped",
                header=_header(t, parent),
                child_frame_id=child,
                transform=transform,
            )
        )
    return _make(TF, transforms=items)


def cloud(t, frame, points):
    """PointCloud2 of points (POINT), stamped t, ns: the time of the first column."""
    fields = [
        _make(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=POINT.fields[name][1],
            datatype=NUMPY_TO_FIELD[POINT[name].name],
            count=1,
        )
        for name in POINT.names
    ]
    data = points.view("u1").reshape(-1)
    return _make(
        CLOUD,
        header=_header(t, frame),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=POINT.itemsize,
        row_step=len(data),
        data=data,
        is_dense=True,
    )


def image(t, frame, pixels, encoding):
    """Image of pixels (height, width[, channels]) uint8, stamped t, ns: the instant of exposure."""
    return _make(
        IMAGE,
        header=_header(t, frame),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=pixels[0].nbytes,
        data=pixels.reshape(-1),
    )


def write(path, messages):
    """Write an MCAP of messages (log time in ns, topic, type, message), sorted by log time."""
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="simulate")
        schemas, channels, counts = {}, {}, {}
        for log_t, topic, name, message in messages:
            if name not in schemas:
                text = STORE.generate_msgdef(name, ros_version=2)[0].encode()
                schemas[name] = writer.register_schema(name, "ros2msg", text)
            if topic not in channels:
                qos = {"offered_qos_profiles": ""}
                channels[topic] = writer.register_channel(topic, "cdr", schemas[name], qos)
            counts[topic] = counts.get(topic, 0) + 1
            data = bytes(STORE.serialize_cdr(message, name))
            writer.add_message(channels[topic], int(log_t), data, int(log_t), counts[topic])
        writer.finish()
    return counts
