"""ROS messages as lidar and camera drivers publish them, and logs of simulated sessions."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys.store import Typestore

from calib.io.logs.mcap_writer import McapOptions, write_mcap
from calib.io.logs.ros_messages import (
    COMPRESSED_IMAGE_TYPE,
    IMAGE_TYPE,
    LASER_SCAN_TYPE,
    LIVOX_POINT_TYPE,
    LIVOX_TYPE,
    RosMessage,
    make_compressed_image,
    make_pointcloud2,
    make_raw_image,
    make_ros_header,
    make_ros_message,
)
from calib.sensors.camera.camera_info_reader import CAMERA_INFO_TYPE
from simulation.sensors.camera_exposure import IMAGE_ENCODERS, compress_image
from simulation.sensors.cloud_formats import Echoes, apply_driver_stamp, make_point_array
from simulation.simulated_rigs import SimulatedCamera

SIMULATED_LOG_OPTIONS = McapOptions(library="simulate", chunk_bytes=1_000_000)
SCAN_DURATION_S = 0.1
ROS1_SEQUENCE_NUMBER = 7  # of every header: nothing reads it


def make_cloud_message(stamp_ns: int, frame: str, driver_name: str, echoes: Echoes) -> Any:
    """Make the message of a driver (SPECIAL_CLOUD_MESSAGES, else a PointCloud2 of CLOUD_FORMATS).

    stamp_ns is the time of the first column.
    """
    if driver_name in SPECIAL_CLOUD_MESSAGES:
        return SPECIAL_CLOUD_MESSAGES[driver_name](stamp_ns, frame, echoes)
    first_ns, echoes = echoes.stamp_ns, apply_driver_stamp(driver_name, echoes)
    points = make_point_array(driver_name, echoes)
    return make_pointcloud2(stamp_ns + echoes.stamp_ns - first_ns, frame, points)


def _livox_custom_message(stamp_ns: int, frame: str, echoes: Echoes) -> Any:
    """Make a Livox CustomMsg of the returns in the order of firing."""
    columns, lines = np.nonzero(echoes.has_return)
    xyz = echoes.xyz[columns, lines].astype(np.float32).tolist()
    offsets_ns = echoes.column_time_ns[columns, 0].tolist()
    points = [
        make_ros_message(
            LIVOX_POINT_TYPE,
            offset_time=offset_ns,
            x=x,
            y=y,
            z=z,
            reflectivity=9,
            tag=0,
            line=line,
        )
        for (x, y, z), offset_ns, line in zip(xyz, offsets_ns, lines.tolist(), strict=True)
    ]
    return make_ros_message(
        LIVOX_TYPE,
        header=make_ros_header(stamp_ns, frame),
        timebase=stamp_ns,
        point_num=len(points),
        lidar_id=1,
        rsvd=np.zeros(3, np.uint8),
        points=points,
    )


def _laser_scan_message(stamp_ns: int, frame: str, echoes: Echoes) -> Any:
    """Make a LaserScan of the first beam, whose columns are evenly spaced in angle and time."""
    hits = np.flatnonzero(echoes.has_return[:, 0])
    angle = np.unwrap(np.arctan2(*echoes.xyz[hits, 0, 1::-1].T))
    step = float(angle[-1] - angle[0]) / float(hits[-1] - hits[0])
    first_angle, n_columns = float(angle[0] - step * hits[0]), len(echoes.has_return)
    column_period_ns = float(echoes.column_time_ns[1, 0] - echoes.column_time_ns[0, 0])
    ranges = np.where(echoes.has_return, echoes.distance_m, np.inf)[:, 0].astype(np.float32)
    return make_ros_message(
        LASER_SCAN_TYPE,
        header=make_ros_header(stamp_ns, frame),
        angle_min=first_angle,
        angle_max=first_angle + step * (n_columns - 1),
        angle_increment=step,
        time_increment=column_period_ns * 1e-9,
        scan_time=SCAN_DURATION_S,
        range_min=0.1,
        range_max=100.0,
        ranges=ranges,
        intensities=np.zeros(0, np.float32),
    )


CloudMessageMaker = Callable[[int, str, Echoes], Any]
SPECIAL_CLOUD_MESSAGES: dict[str, CloudMessageMaker] = {
    "livox_custom": _livox_custom_message,
    "laserscan": _laser_scan_message,
}


def make_image_message(
    stamp_ns: int, frame: str, camera_spec: SimulatedCamera, pixels: np.ndarray
) -> tuple[str, str, Any]:
    """Make (topic, type, message) of pixels (height, width[, channels]) uint8, BGR or grey.

    The camera's encoding says what the message holds; stamp_ns is the middle of the exposure.
    """
    if camera_spec.is_compressed:
        data = compress_image(pixels, camera_spec.encoding)
        format_text = f"bgr8; {camera_spec.encoding} compressed bgr8"
        message = make_compressed_image(stamp_ns, frame, format_text, data)
        return f"{camera_spec.topic}/compressed", COMPRESSED_IMAGE_TYPE, message
    data = IMAGE_ENCODERS[camera_spec.encoding](pixels)
    message = make_raw_image(stamp_ns, frame, camera_spec.encoding, data)
    return camera_spec.topic, IMAGE_TYPE, message


def convert_to_ros1(message: Any, ros1_types: Typestore) -> Any:
    """Convert a ROS 2 message, or a value in it, to the ROS 1 types of a store.

    In ROS 1 headers are numbered and the matrices of CameraInfo have capital names.
    """
    if isinstance(message, list):
        return [convert_to_ros1(v, ros1_types) for v in message]
    if not hasattr(message, "__msgtype__"):
        return message
    fields = {k: convert_to_ros1(v, ros1_types) for k, v in vars(message).items()}
    if message.__msgtype__ == "std_msgs/msg/Header":
        fields["seq"] = ROS1_SEQUENCE_NUMBER
    if message.__msgtype__ == CAMERA_INFO_TYPE:
        fields = {k.upper() if k in "dkrp" else k: v for k, v in fields.items()}
    return ros1_types.types[message.__msgtype__](**fields)


def write_rosbags_log(
    writer: Rosbag1Writer | Rosbag2Writer,
    messages: Iterable[RosMessage],
    ros_types: Typestore,
    serialize: Callable[[str, Any], bytes],
) -> None:
    """Write messages with a writer of rosbags; serialize takes the type and the message."""
    with writer:
        connections: dict[str, Any] = {}
        for log_time_ns, topic, type_name, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_name, typestore=ros_types)
            writer.write(connections[topic], log_time_ns, serialize(type_name, message))


def write_simulated_mcap(path: Path, messages: Iterable[RosMessage]) -> dict[str, int]:
    """Write an MCAP of messages in log time order; returns the messages per topic."""
    with open(path, "wb") as stream:
        return write_mcap(stream, messages, SIMULATED_LOG_OPTIONS)
