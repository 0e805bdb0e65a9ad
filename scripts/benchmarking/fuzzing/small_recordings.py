"""Small recordings with all message types that decode reads, in all containers."""

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from calib.geometry.se3 import make_pose, se3_exp
from calib.io.logs.ros_messages import (
    CLOUD_TYPE,
    COMPRESSED_IMAGE_TYPE,
    IMAGE_TYPE,
    LASER_SCAN_TYPE,
    LIVOX_POINT_TYPE,
    LIVOX_TYPE,
    ROS2_TYPES,
    TF_TYPE,
    RosMessage,
    make_compressed_image,
    make_pointcloud2,
    make_raw_image,
    make_ros_header,
    make_ros_message,
    make_ros_quaternion,
    make_tf_message,
)
from calib.sensors.camera.camera_info_reader import CAMERA_INFO_TYPE
from calib.sensors.camera.camera_info_writer import make_camera_info_message
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.camera.images.image_messages import encode_png
from simulation.ros_log import convert_to_ros1, write_rosbags_log

FUZZ_START_NS, POSE_PERIOD_NS = 1_700_000_000_000_000_000, 10_000_000  # ns
ROS1_TYPES = get_typestore(Stores.ROS1_NOETIC)
N_POSES = 16
CHUNK_BYTES = 4000
POSE_TYPE = "geometry_msgs/msg/PoseStamped"
# Sensors of one log; a log with all of them would take twice as long to read.
SENSOR_GROUPS = (("camera", "lidar"), ("compressed", "livox"), ("scanner",))
FUZZ_SENSORS = {
    "camera": {"kind": "camera", "topic": "/image", "camera_info": "/camera_info"},
    "compressed": {"kind": "camera", "topic": "/compressed"},
    "lidar": {"kind": "lidar", "topic": "/points"},
    "livox": {"kind": "lidar", "topic": "/livox"},
    "scanner": {"kind": "lidar", "topic": "/scan"},
}
COMMON_DECODE_OPTIONS = {
    "mocap": {
        "topics": {"/tf": None, "/pose": "cart"},
        "map": "world",
        "max_gap_s": 0.05,
        "unit": "auto",
        "quaternions": "auto",
    },
    "bodies": ["board", "cart", "robot"],
    "fingerprint": [],
    "from_s": None,
    "to_s": None,
}


def _pose_message(t: int, T: np.ndarray) -> Any:
    x, y, z = T[:3, 3].tolist()
    pose = make_ros_message(
        "geometry_msgs/msg/Pose",
        position=make_ros_message("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=make_ros_quaternion(T),
    )
    return make_ros_message(POSE_TYPE, header=make_ros_header(t, "world"), pose=pose)


def _image_pixels() -> np.ndarray:
    return np.arange(48, dtype=np.uint8).reshape(4, 4, 3)


def _image_message(t: int) -> Any:
    return make_raw_image(t, "lens", "bgr8", _image_pixels())


def _compressed_image_message(t: int) -> Any:
    data = np.frombuffer(encode_png(_image_pixels()), np.uint8)
    return make_compressed_image(t, "lens", "png", data)


def _camera_info_message(t: int) -> Any:
    camera = CameraModel("radtan", (5.0, 5.0, *[0.0] * 6), (4, 4))
    return make_camera_info_message(t, "lens", camera)


def _cloud_message(t: int) -> Any:
    layout = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2"), ("time", "f4")])
    points = np.zeros((1, 6), layout)
    points["x"], points["ring"], points["time"] = 1 + np.arange(6), range(6), np.arange(6) * 1e-3
    return make_pointcloud2(t, "lidar", points)


def _livox_message(t: int) -> Any:
    points = [
        make_ros_message(
            LIVOX_POINT_TYPE, offset_time=i * 1000, x=1.0 + i, y=0.0, z=0.0, reflectivity=9, tag=0,
            line=i,
        )
        for i in range(4)
    ]  # fmt: skip
    return make_ros_message(
        LIVOX_TYPE, header=make_ros_header(t, "livox"), timebase=t, point_num=4, lidar_id=1,
        rsvd=np.zeros(3, np.uint8), points=points,
    )  # fmt: skip


def _laser_scan_message(t: int) -> Any:
    return make_ros_message(
        LASER_SCAN_TYPE, header=make_ros_header(t, "scanner"), angle_min=-1.0, angle_max=1.0,
        angle_increment=0.5, time_increment=1e-4, scan_time=0.1, range_min=0.1, range_max=100.0,
        ranges=np.arange(5, dtype=np.float32), intensities=np.zeros(0, np.float32),
    )  # fmt: skip


SENSOR_TOPICS = {
    "/image": (IMAGE_TYPE, _image_message),
    "/compressed": (COMPRESSED_IMAGE_TYPE, _compressed_image_message),
    "/camera_info": (CAMERA_INFO_TYPE, _camera_info_message),
    "/points": (CLOUD_TYPE, _cloud_message),
    "/livox": (LIVOX_TYPE, _livox_message),
    "/scan": (LASER_SCAN_TYPE, _laser_scan_message),
}


def fuzz_decode_options(sensor_names: tuple[str, ...]) -> dict[str, Any]:
    """Return the options of decode for a log of these sensors, without the path of the log."""
    return COMMON_DECODE_OPTIONS | {"sensors": {name: FUZZ_SENSORS[name] for name in sensor_names}}


@cache
def make_fuzz_messages(sensor_names: tuple[str, ...]) -> list[RosMessage]:
    """Return the messages of a recording of these sensors, in the order of log time."""
    out: list[RosMessage] = []
    wanted = {
        FUZZ_SENSORS[n][k]
        for n in sensor_names
        for k in ("topic", "camera_info")
        if k in FUZZ_SENSORS[n]
    }
    for i in range(N_POSES):
        t = FUZZ_START_NS + i * POSE_PERIOD_NS
        T = se3_exp(np.array([0.01 * i, 0, 0, 0, 0, 0.02 * i]))
        both = {"robot": T, "board": make_pose(t=[2.0, 0, 1]) @ T}
        out.append(RosMessage(t, "/tf", TF_TYPE, make_tf_message(t, "world", both)))
        out.append(RosMessage(t + 1, "/pose", POSE_TYPE, _pose_message(t, T)))
        if i % 4 == 0:
            out += [
                RosMessage(t + 2 + k, topic, name, make(t))
                for k, (topic, (name, make)) in enumerate(SENSOR_TOPICS.items())
                if topic in wanted
            ]
    return out


def _write_mcap(path: Path, messages: Iterable[RosMessage], **options: Any) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream, **({"chunk_size": CHUNK_BYTES} | options))
        writer.start(profile="ros2", library="benchmark")
        schemas, channels = {}, {}
        for log_t, topic, name, message in messages:
            if name not in schemas:
                text = ROS2_TYPES.generate_msgdef(name, ros_version=2)[0].encode()
                schemas[name] = writer.register_schema(name, "ros2msg", text)
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schemas[name])
            data = bytes(ROS2_TYPES.serialize_cdr(message, name))
            writer.add_message(channels[topic], log_t, data, log_t)
        writer.finish()
    return path


def _write_rosbag2(
    folder: Path,
    messages: Iterable[RosMessage],
    plugin: StoragePlugin,
    compression: CompressionMode | None = None,
) -> Path:
    writer = Rosbag2Writer(folder / "bag", version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    write_rosbags_log(
        writer, messages, ROS2_TYPES, lambda name, m: bytes(ROS2_TYPES.serialize_cdr(m, name))
    )
    (path,) = (p for p in (folder / "bag").iterdir() if p.name != "metadata.yaml")
    return path


def _write_ros1_bag(path: Path, messages: Iterable[RosMessage], compression: Any = None) -> Path:
    writer = BagWriter(path)
    writer.chunk_threshold = CHUNK_BYTES
    if compression:
        writer.set_compression(compression)
    known = [row for row in messages if row[2] in ROS1_TYPES.types]
    write_rosbags_log(writer, known, ROS1_TYPES, _serialize_ros1)
    return path


def _serialize_ros1(name: str, message: Any) -> bytes:
    return bytes(ROS1_TYPES.serialize_ros1(convert_to_ros1(message, ROS1_TYPES), name))


BagCompression = BagWriter.CompressionFormat
# Each function writes messages into a folder and returns the file that contains them.
FUZZ_CONTAINERS = {
    "mcap, zstd": lambda f, rows: _write_mcap(f / "a.mcap", rows, compression=CompressionType.ZSTD),
    "mcap, lz4": lambda f, rows: _write_mcap(f / "a.mcap", rows, compression=CompressionType.LZ4),
    "mcap, none": lambda f, rows: _write_mcap(f / "a.mcap", rows, compression=CompressionType.NONE),
    "mcap, no chunks": lambda f, rows: _write_mcap(f / "a.mcap", rows, use_chunking=False),
    "mcap, whole in zstd": lambda f, rows: _write_rosbag2(
        f, rows, StoragePlugin.MCAP, CompressionMode.FILE
    ),
    "sqlite": lambda f, rows: _write_rosbag2(f, rows, StoragePlugin.SQLITE3),
    "sqlite, messages in zstd": lambda f, rows: _write_rosbag2(
        f, rows, StoragePlugin.SQLITE3, CompressionMode.MESSAGE
    ),
    "bag": lambda f, rows: _write_ros1_bag(f / "a.bag", rows),
    "bag, bz2": lambda f, rows: _write_ros1_bag(f / "a.bag", rows, BagCompression.BZ2),
    "bag, lz4": lambda f, rows: _write_ros1_bag(f / "a.bag", rows, BagCompression.LZ4),
}


def write_fuzz_log(container: str, folder: Path, messages: Iterable[RosMessage]) -> Path:
    """Write messages in a container into an empty folder; return the file that contains them."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    return FUZZ_CONTAINERS[container](Path(folder), messages)
