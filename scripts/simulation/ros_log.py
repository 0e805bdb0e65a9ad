"""ROS 2 messages and the MCAP file that holds them, the same bytes for the same messages."""

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from calib.geometry.se3 import pose_to_quat
from simulation.sensors.camera_exposure import IMAGE_ENCODERS, compress_image
from simulation.sensors.cloud_formats import apply_driver_stamp, make_point_array

ROS2_TYPES = get_typestore(Stores.ROS2_HUMBLE)
ROS2_TYPES.register(
    get_types_from_msg(
        "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\n"
        "uint8[3] rsvd\nCustomPoint[] points",
        "livox_ros_driver2/msg/CustomMsg",
    )
    | get_types_from_msg(
        "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\n"
        "uint8 line",
        "livox_ros_driver2/msg/CustomPoint",
    )
)
CHUNK_BYTES = 1_000_000
TF_TYPE, CLOUD_TYPE, IMAGE_TYPE = (
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/Image",
)
COMPRESSED_IMAGE_TYPE, CAMERA_INFO_TYPE = (
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
)
LASER_SCAN_TYPE, LIVOX_TYPE = "sensor_msgs/msg/LaserScan", "livox_ros_driver2/msg/CustomMsg"
NUMPY_TO_POINT_FIELD = {"int8": 1, "uint8": 2, "uint16": 4, "uint32": 6, "float32": 7, "float64": 8}
ROS_DISTORTION_MODELS = {
    "radtan": ("plumb_bob", 5),
    "kannala_brandt": ("equidistant", 4),
}  # name, numbers


def _make_message(name, /, **fields):
    return ROS2_TYPES.types[name](**fields)


def _make_header(t, frame):
    stamp = _make_message(
        "builtin_interfaces/msg/Time", sec=int(t // 10**9), nanosec=int(t % 10**9)
    )
    return _make_message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def make_tf_message(t, parent, T_parent_child):
    """TFMessage of the poses T_parent_child (4, 4) by child frame, all stamped t, ns."""
    items, quats = [], pose_to_quat(np.stack(list(T_parent_child.values())))
    for (child, T), quat in zip(T_parent_child.items(), quats, strict=True):
        x, y, z, w = (float(c) for c in quat)
        xyz = dict(zip("xyz", (float(c) for c in T[:3, 3]), strict=True))
        transform = _make_message(
            "geometry_msgs/msg/Transform",
            translation=_make_message("geometry_msgs/msg/Vector3", **xyz),
            rotation=_make_message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        )
        items.append(
            _make_message(
                "geometry_msgs/msg/TransformStamped",
                header=_make_header(t, parent),
                child_frame_id=child,
                transform=transform,
            )
        )
    return _make_message(TF_TYPE, transforms=items)


def make_cloud_message(t, frame, driver_name, echoes):
    """Message of a driver_name (MESSAGES, or PointCloud2 of drivers.DRIVERS) whose first column is
    fired at t, ns."""
    if driver_name in SPECIAL_CLOUD_MESSAGES:
        return SPECIAL_CLOUD_MESSAGES[driver_name](t, frame, echoes)
    first, echoes = echoes.stamp_ns, apply_driver_stamp(driver_name, echoes)
    points = make_point_array(driver_name, echoes)
    layout, (height, width) = points.dtype, points.shape
    fields = [
        _make_message(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=layout.fields[name][1],
            datatype=NUMPY_TO_POINT_FIELD[layout[name].name],
            count=1,
        )
        for name in layout.names
    ]
    return _make_message(
        CLOUD_TYPE,
        header=_make_header(t + echoes.stamp_ns - first, frame),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=False,
        point_step=layout.itemsize,
        row_step=width * layout.itemsize,
        data=points.reshape(-1).view("u1"),
        is_dense=True,
    )


def _livox_custom_message(t, frame, echoes):
    """Livox CustomMsg of the returns in the order of firing."""
    columns, lines = np.nonzero(echoes.has_return)
    xyz = echoes.xyz[columns, lines].astype(np.float32).tolist()
    after = echoes.column_time_ns[columns, 0].tolist()
    points = [
        _make_message(f"{LIVOX_TYPE.removesuffix('Msg')}Point", offset_time=dt, x=x, y=y, z=z, reflectivity=9,
              tag=0, line=line)
        for (x, y, z), dt, line in zip(xyz, after, lines.tolist(), strict=True)
    ]  # fmt: skip
    return _make_message(
        LIVOX_TYPE, header=_make_header(t, frame), timebase=t, point_num=len(points), lidar_id=1,
        rsvd=np.zeros(3, np.uint8), points=points,
    )  # fmt: skip


def _laser_scan_message(t, frame, echoes):
    """LaserScan of the first beam, whose columns are evenly spaced in angle and time."""
    seen = np.flatnonzero(echoes.has_return[:, 0])
    angle = np.unwrap(np.arctan2(*echoes.xyz[seen, 0, 1::-1].T))
    step = float(angle[-1] - angle[0]) / float(seen[-1] - seen[0])
    first, n = float(angle[0] - step * seen[0]), len(echoes.has_return)
    after = float(echoes.column_time_ns[1, 0] - echoes.column_time_ns[0, 0])
    ranges = np.where(echoes.has_return, echoes.distance_m, np.inf)[:, 0].astype(np.float32)
    return _make_message(
        LASER_SCAN_TYPE, header=_make_header(t, frame), angle_min=first, angle_max=first + step * (n - 1),
        angle_increment=step, time_increment=after * 1e-9, scan_time=0.1, range_min=0.1,
        range_max=100.0, ranges=ranges, intensities=np.zeros(0, np.float32),
    )  # fmt: skip


SPECIAL_CLOUD_MESSAGES = {"livox_custom": _livox_custom_message, "laserscan": _laser_scan_message}


def make_image_message(t, frame, camera_spec, pixels):
    """(topic, type, message) of pixels (height, width[, channels]) uint8 in the encoding of a
    rigs.Camera; t, ns, is the middle of the exposure."""
    if camera_spec.is_compressed:
        data = compress_image(pixels, camera_spec.encoding)
        what = f"bgr8; {camera_spec.encoding} compressed bgr8"
        message = _make_message(
            COMPRESSED_IMAGE_TYPE, header=_make_header(t, frame), format=what, data=data
        )
        return f"{camera_spec.topic}/compressed", COMPRESSED_IMAGE_TYPE, message
    data = np.ascontiguousarray(IMAGE_ENCODERS[camera_spec.encoding](pixels))
    message = _make_message(
        IMAGE_TYPE,
        header=_make_header(t, frame),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=camera_spec.encoding,
        is_bigendian=0,
        step=data[0].nbytes,
        data=data.reshape(-1).view(np.uint8),
    )
    return camera_spec.topic, IMAGE_TYPE, message


def build_camera_info_factory(camera):
    """A function of t, ns, and frame that makes the CameraInfo of a Camera; None where ROS has no
    name for the model."""
    if camera.model not in ROS_DISTORTION_MODELS:
        return None
    model, count = ROS_DISTORTION_MODELS[camera.model]
    fx, fy, cx, cy, *d = camera.params
    K = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0])
    P = np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1.0, 0])
    region = _make_message(
        "sensor_msgs/msg/RegionOfInterest",
        **dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0),
        do_rectify=False,
    )
    width, height = camera.size_px
    return lambda t, frame: _make_message(
        CAMERA_INFO_TYPE,
        header=_make_header(t, frame),
        height=height,
        width=width,
        distortion_model=model,
        d=np.array(d[:count]),
        k=K,
        r=np.eye(3).ravel(),
        p=P,
        binning_x=0,
        binning_y=0,
        roi=region,
    )


def convert_to_ros1(message, ros1_types):
    """The same message, or what it holds, of ROS 1, whose types a store has: headers are numbered
    and the fields of CameraInfo begin with a capital."""
    if isinstance(message, list):
        return [convert_to_ros1(v, ros1_types) for v in message]
    if not hasattr(message, "__msgtype__"):
        return message
    fields = {k: convert_to_ros1(v, ros1_types) for k, v in vars(message).items()}
    numbered = {"seq": 7} if message.__msgtype__ == "std_msgs/msg/Header" else {}
    if message.__msgtype__ == CAMERA_INFO_TYPE:
        fields = {k.upper() if k in "dkrp" else k: v for k, v in fields.items()}
    return ros1_types.types[message.__msgtype__](**fields, **numbered)


def write_rosbags_log(writer, messages, ros_types, serialise):
    """Write messages (log time in ns, topic, type, message) by a writer of rosbags."""
    with writer:
        topics = {}
        for log_t, topic, name, message in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, name, typestore=ros_types)
            writer.write(topics[topic], log_t, serialise(name, message))


def write_simulated_mcap(path, messages):
    """Write an MCAP of messages (log time in ns, topic, type, message), sorted by log time."""
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="simulate")
        schemas, channels, counts = {}, {}, {}
        for log_t, topic, name, message in messages:
            if name not in schemas:
                text = ROS2_TYPES.generate_msgdef(name, ros_version=2)[0].encode()
                schemas[name] = writer.register_schema(name, "ros2msg", text)
            if topic not in channels:
                qos = {"offered_qos_profiles": ""}
                channels[topic] = writer.register_channel(topic, "cdr", schemas[name], qos)
            counts[topic] = counts.get(topic, 0) + 1
            data = bytes(ROS2_TYPES.serialize_cdr(message, name))
            writer.add_message(channels[topic], int(log_t), data, int(log_t), counts[topic])
        writer.finish()
    return counts
