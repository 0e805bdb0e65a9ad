"""ROS 2 messages and the MCAP file that holds them, the same bytes for the same messages."""

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from calib.geometry.se3 import to_quat
from simulation.sensors import camera_exposure, cloud_formats

STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE.register(
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
TF, CLOUD, IMAGE = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image"
COMPRESSED, INFO = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"
SCAN, LIVOX = "sensor_msgs/msg/LaserScan", "livox_ros_driver2/msg/CustomMsg"
NUMPY_TO_FIELD = {"int8": 1, "uint8": 2, "uint16": 4, "uint32": 6, "float32": 7, "float64": 8}
DISTORTION = {"radtan": ("plumb_bob", 5), "kannala_brandt": ("equidistant", 4)}  # name, numbers


def _make(name, /, **fields):
    return STORE.types[name](**fields)


def _header(t, frame):
    stamp = _make("builtin_interfaces/msg/Time", sec=int(t // 10**9), nanosec=int(t % 10**9))
    return _make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def transforms(t, parent, T_parent_child):
    """TFMessage of the poses T_parent_child (4, 4) by child frame, all stamped t, ns."""
    items, quats = [], to_quat(np.stack(list(T_parent_child.values())))
    for (child, T), quat in zip(T_parent_child.items(), quats, strict=True):
        x, y, z, w = (float(c) for c in quat)
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


def cloud(t, frame, driver, echoes):
    """Message of a driver (MESSAGES, or PointCloud2 of drivers.DRIVERS) whose first column is
    fired at t, ns."""
    if driver in MESSAGES:
        return MESSAGES[driver](t, frame, echoes)
    first, echoes = echoes.t, cloud_formats.stamped(driver, echoes)
    points = cloud_formats.points(driver, echoes)
    layout, (height, width) = points.dtype, points.shape
    fields = [
        _make(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=layout.fields[name][1],
            datatype=NUMPY_TO_FIELD[layout[name].name],
            count=1,
        )
        for name in layout.names
    ]
    return _make(
        CLOUD,
        header=_header(t + echoes.t - first, frame),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=False,
        point_step=layout.itemsize,
        row_step=width * layout.itemsize,
        data=points.reshape(-1).view("u1"),
        is_dense=True,
    )


def _custom(t, frame, echoes):
    """Livox CustomMsg of the returns in the order of firing."""
    columns, lines = np.nonzero(echoes.returned)
    xyz = echoes.xyz[columns, lines].astype(np.float32).tolist()
    after = echoes.after[columns, 0].tolist()
    points = [
        _make(f"{LIVOX.removesuffix('Msg')}Point", offset_time=dt, x=x, y=y, z=z, reflectivity=9,
              tag=0, line=line)
        for (x, y, z), dt, line in zip(xyz, after, lines.tolist(), strict=True)
    ]  # fmt: skip
    return _make(
        LIVOX, header=_header(t, frame), timebase=t, point_num=len(points), lidar_id=1,
        rsvd=np.zeros(3, np.uint8), points=points,
    )  # fmt: skip


def _scan(t, frame, echoes):
    """LaserScan of the first beam, whose columns are evenly spaced in angle and time."""
    seen = np.flatnonzero(echoes.returned[:, 0])
    angle = np.unwrap(np.arctan2(*echoes.xyz[seen, 0, 1::-1].T))
    step = float(angle[-1] - angle[0]) / float(seen[-1] - seen[0])
    first, n = float(angle[0] - step * seen[0]), len(echoes.returned)
    after = float(echoes.after[1, 0] - echoes.after[0, 0])
    ranges = np.where(echoes.returned, echoes.distance, np.inf)[:, 0].astype(np.float32)
    return _make(
        SCAN, header=_header(t, frame), angle_min=first, angle_max=first + step * (n - 1),
        angle_increment=step, time_increment=after * 1e-9, scan_time=0.1, range_min=0.1,
        range_max=100.0, ranges=ranges, intensities=np.zeros(0, np.float32),
    )  # fmt: skip


MESSAGES = {"livox_custom": _custom, "laserscan": _scan}


def image(t, frame, spec, pixels):
    """(topic, type, message) of pixels (height, width[, channels]) uint8 in the encoding of a
    rigs.Camera; t, ns, is the middle of the exposure."""
    if spec.compressed:
        data = camera_exposure.compress(pixels, spec.encoding)
        what = f"bgr8; {spec.encoding} compressed bgr8"
        message = _make(COMPRESSED, header=_header(t, frame), format=what, data=data)
        return f"{spec.topic}/compressed", COMPRESSED, message
    data = np.ascontiguousarray(camera_exposure.ENCODINGS[spec.encoding](pixels))
    message = _make(
        IMAGE,
        header=_header(t, frame),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=spec.encoding,
        is_bigendian=0,
        step=data[0].nbytes,
        data=data.reshape(-1).view(np.uint8),
    )
    return spec.topic, IMAGE, message


def camera_info(camera):
    """A function of t, ns, and frame that makes the CameraInfo of a Camera; None where ROS has no
    name for the model."""
    if camera.model not in DISTORTION:
        return None
    model, count = DISTORTION[camera.model]
    fx, fy, cx, cy, *d = camera.params
    K = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0])
    P = np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1.0, 0])
    region = _make(
        "sensor_msgs/msg/RegionOfInterest",
        **dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0),
        do_rectify=False,
    )
    width, height = camera.size
    return lambda t, frame: _make(
        INFO,
        header=_header(t, frame),
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


def of_ros1(value, store):
    """The same message, or what it holds, of ROS 1, whose types a store has: headers are numbered
    and the fields of CameraInfo begin with a capital."""
    if isinstance(value, list):
        return [of_ros1(v, store) for v in value]
    if not hasattr(value, "__msgtype__"):
        return value
    fields = {k: of_ros1(v, store) for k, v in vars(value).items()}
    numbered = {"seq": 7} if value.__msgtype__ == "std_msgs/msg/Header" else {}
    if value.__msgtype__ == INFO:
        fields = {k.upper() if k in "dkrp" else k: v for k, v in fields.items()}
    return store.types[value.__msgtype__](**fields, **numbered)


def record(writer, messages, store, serialise):
    """Write messages (log time in ns, topic, type, message) by a writer of rosbags."""
    with writer:
        topics = {}
        for log_t, topic, name, message in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, name, typestore=store)
            writer.write(topics[topic], log_t, serialise(name, message))


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
