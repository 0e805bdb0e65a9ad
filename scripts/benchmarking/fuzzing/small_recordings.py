"""A small recording of every kind of message that decode reads, in every container."""

from functools import cache
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from calib.geometry import se3
from calib.sensors.camera.images import image_messages
from simulation import ros_log

BEGIN, STEP = 1_700_000_000_000_000_000, 10_000_000  # ns
STORE, STORE1 = ros_log.STORE, get_typestore(Stores.ROS1_NOETIC)
POSES = 16
CHUNK_BYTES = 4000
POSE = "geometry_msgs/msg/PoseStamped"
# What is recorded together, for a log of everything would take twice as long to read.
RECORDED = (("camera", "lidar"), ("compressed", "livox"), ("scanner",))
SENSORS = {
    "camera": {"kind": "camera", "topic": "/image", "camera_info": "/camera_info"},
    "compressed": {"kind": "camera", "topic": "/compressed"},
    "lidar": {"kind": "lidar", "topic": "/points"},
    "livox": {"kind": "lidar", "topic": "/livox"},
    "scanner": {"kind": "lidar", "topic": "/scan"},
}
OPTIONS = {
    "mocap": {"topics": {"/tf": None, "/pose": "cart"}, "map": "world", "max_gap_s": 0.05},
    "bodies": ["board", "cart", "robot"],
    "fingerprint": [],
    "from_s": None,
    "to_s": None,
}


def _make(name, /, **fields):
    return STORE.types[name](**fields)


def _header(t, frame):
    stamp = _make("builtin_interfaces/msg/Time", sec=t // 10**9, nanosec=t % 10**9)
    return _make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _pose(t, T):
    (x, y, z), q = T[:3, 3].tolist(), se3.to_quat(T).tolist()
    pose = _make(
        "geometry_msgs/msg/Pose",
        position=_make("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=_make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", q, strict=True))),
    )
    return _make(POSE, header=_header(t, "world"), pose=pose)


def _pixels():
    return np.arange(48, dtype=np.uint8).reshape(4, 4, 3)


def _image(t):
    about = {"height": 4, "width": 4, "encoding": "bgr8", "is_bigendian": 0, "step": 12}
    return _make(ros_log.IMAGE, header=_header(t, "lens"), **about, data=_pixels().reshape(-1))


def _compressed(t):
    data = np.frombuffer(image_messages.to_png(_pixels()), np.uint8)
    return _make(ros_log.COMPRESSED, header=_header(t, "lens"), format="png", data=data)


def _info(t):
    numbers = {"d": np.zeros(5), "k": np.eye(3).ravel(), "r": np.eye(3).ravel(), "p": np.eye(3, 4)}
    numbers["k"][[0, 4]] = numbers["p"].reshape(-1)[[0, 5]] = 5.0
    region = dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0)
    return _make(
        ros_log.INFO, header=_header(t, "lens"), height=4, width=4, distortion_model="plumb_bob",
        binning_x=0, binning_y=0, **{k: v.ravel() for k, v in numbers.items()},
        roi=_make("sensor_msgs/msg/RegionOfInterest", **region, do_rectify=False),
    )  # fmt: skip


def _cloud(t):
    layout = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2"), ("time", "f4")])
    points = np.zeros(6, layout)
    points["x"], points["ring"], points["time"] = 1 + np.arange(6), range(6), np.arange(6) * 1e-3
    fields = [
        _make(
            "sensor_msgs/msg/PointField", name=k, offset=layout.fields[k][1],
            datatype=ros_log.NUMPY_TO_FIELD[layout[k].name], count=1,
        )
        for k in layout.names
    ]  # fmt: skip
    shape = {"height": 1, "width": 6, "point_step": layout.itemsize}
    shape["row_step"] = 6 * layout.itemsize
    flags = {"is_bigendian": False, "is_dense": True}
    about = {"header": _header(t, "lidar"), "fields": fields, "data": points.view(np.uint8)}
    return _make(ros_log.CLOUD, **about, **shape, **flags)


def _livox(t):
    points = [
        _make("livox_ros_driver2/msg/CustomPoint", offset_time=i * 1000, x=1.0 + i, y=0.0, z=0.0,
              reflectivity=9, tag=0, line=i)
        for i in range(4)
    ]  # fmt: skip
    return _make(
        ros_log.LIVOX, header=_header(t, "livox"), timebase=t, point_num=4, lidar_id=1,
        rsvd=np.zeros(3, np.uint8), points=points,
    )  # fmt: skip


def _scan(t):
    return _make(
        ros_log.SCAN, header=_header(t, "scanner"), angle_min=-1.0, angle_max=1.0,
        angle_increment=0.5, time_increment=1e-4, scan_time=0.1, range_min=0.1, range_max=100.0,
        ranges=np.arange(5, dtype=np.float32), intensities=np.zeros(0, np.float32),
    )  # fmt: skip


TOPICS = {
    "/image": (ros_log.IMAGE, _image),
    "/compressed": (ros_log.COMPRESSED, _compressed),
    "/camera_info": (ros_log.INFO, _info),
    "/points": (ros_log.CLOUD, _cloud),
    "/livox": (ros_log.LIVOX, _livox),
    "/scan": (ros_log.SCAN, _scan),
}


def options(names):
    """What decode is given for a log of the sensors so named, but for the log."""
    return OPTIONS | {"sensors": {name: SENSORS[name] for name in names}}


@cache
def rows(names):
    """(log time, ns; topic; type; message) of a recording of the sensors so named, by log time."""
    out, wanted = (
        [],
        {SENSORS[n][k] for n in names for k in ("topic", "camera_info") if k in SENSORS[n]},
    )
    for i in range(POSES):
        t = BEGIN + i * STEP
        T = se3.se3_exp(np.array([0.01 * i, 0, 0, 0, 0, 0.02 * i]))
        both = {"robot": T, "board": se3.pose(t=[2.0, 0, 1]) @ T}
        out.append((t, "/tf", ros_log.TF, ros_log.transforms(t, "world", both)))
        out.append((t + 1, "/pose", POSE, _pose(t, T)))
        if i % 4 == 0:
            out += [
                (t + 2 + k, topic, name, make(t))
                for k, (topic, (name, make)) in enumerate(TOPICS.items())
                if topic in wanted
            ]
    return out


def _mcap(path, rows, **options):
    with path.open("wb") as stream:
        writer = Writer(stream, **({"chunk_size": CHUNK_BYTES} | options))
        writer.start(profile="ros2", library="benchmark")
        schemas, channels = {}, {}
        for log_t, topic, name, message in rows:
            if name not in schemas:
                text = STORE.generate_msgdef(name, ros_version=2)[0].encode()
                schemas[name] = writer.register_schema(name, "ros2msg", text)
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schemas[name])
            data = bytes(STORE.serialize_cdr(message, name))
            writer.add_message(channels[topic], log_t, data, log_t)
        writer.finish()
    return path


def _rosbag2(folder, rows, plugin, compression=None):
    writer = Rosbag2Writer(folder / "bag", version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    ros_log.record(writer, rows, STORE, lambda name, m: bytes(STORE.serialize_cdr(m, name)))
    (path,) = (p for p in (folder / "bag").iterdir() if p.name != "metadata.yaml")
    return path


def _bag(path, rows, compression=None):
    writer = BagWriter(path)
    writer.chunk_threshold = CHUNK_BYTES
    if compression:
        writer.set_compression(compression)
    known = [row for row in rows if row[2] in STORE1.types]
    ros_log.record(writer, known, STORE1, _ros1)
    return path


def _ros1(name, message):
    return bytes(STORE1.serialize_ros1(ros_log.of_ros1(message, STORE1), name))


Format = BagWriter.CompressionFormat
# Each writes rows below a folder and gives the file that holds them.
CONTAINERS = {
    "mcap, zstd": lambda f, rows: _mcap(f / "a.mcap", rows, compression=CompressionType.ZSTD),
    "mcap, lz4": lambda f, rows: _mcap(f / "a.mcap", rows, compression=CompressionType.LZ4),
    "mcap, none": lambda f, rows: _mcap(f / "a.mcap", rows, compression=CompressionType.NONE),
    "mcap, no chunks": lambda f, rows: _mcap(f / "a.mcap", rows, use_chunking=False),
    "mcap, whole in zstd": lambda f, rows: _rosbag2(
        f, rows, StoragePlugin.MCAP, CompressionMode.FILE
    ),
    "sqlite": lambda f, rows: _rosbag2(f, rows, StoragePlugin.SQLITE3),
    "sqlite, messages in zstd": lambda f, rows: _rosbag2(
        f, rows, StoragePlugin.SQLITE3, CompressionMode.MESSAGE
    ),
    "bag": lambda f, rows: _bag(f / "a.bag", rows),
    "bag, bz2": lambda f, rows: _bag(f / "a.bag", rows, Format.BZ2),
    "bag, lz4": lambda f, rows: _bag(f / "a.bag", rows, Format.LZ4),
}


def write(container, folder, rows):
    """The file that holds rows in a container, below an empty folder."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    return CONTAINERS[container](Path(folder), rows)
