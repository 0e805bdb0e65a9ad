"""The registry of cloud message types: lidar messages as arrays.

To add a type: write calib/sensors/lidar/clouds/<name>.py with the function of CloudReader, and add
one line to CLOUD_TYPES. cloud_layout infers which fields are the time and the beam of a point.
"""

from typing import Any, NamedTuple, Protocol

import numpy as np

from calib.geometry.units import NS_PER_S
from calib.io.status import MessageError, guard_message_fields
from calib.sensors.lidar.clouds import foxglove_cloud, laser_scan, livox_custom, pointcloud2
from calib.sensors.lidar.clouds.beam_inference import assign_beams
from calib.sensors.lidar.clouds.cloud_layout import CloudLayout
from calib.sensors.lidar.clouds.point_time_inference import point_times_ns
from calib.sensors.lidar.clouds.raw_cloud import (
    RawCloud,
    has_return,
    read_intensity,
    select_cloud_points,
    stack_xyz,
)


class CloudReader(Protocol):
    """A message type, as one module."""

    def read(self, message: Any) -> RawCloud:
        """Return all points of a message of the log; raises MessageError if it is damaged."""


CLOUD_TYPES: dict[str, CloudReader] = {
    "sensor_msgs/msg/PointCloud2": pointcloud2,
    "livox_ros_driver/msg/CustomMsg": livox_custom,
    "livox_ros_driver2/msg/CustomMsg": livox_custom,
    "sensor_msgs/msg/LaserScan": laser_scan,
    "foxglove_msgs/msg/PointCloud": foxglove_cloud,
}

_PACKETS_REMEDY = (
    "These are the lidar's packets. Replay the log through its driver, record the PointCloud2 that "
    "the driver publishes, and name that topic."
)
_COMPRESSED_REMEDY = (
    "Decompress it with `ros2 run point_cloud_transport republish`, record the PointCloud2, and "
    "name that topic."
)
_PROTOBUF_CLOUD_REMEDY = (
    "Write it as {0} in ROS encoding (CDR), or record the driver's own ROS topic."
)
# Remedy by type name (fnmatch pattern) of known types that are not supported.
UNSUPPORTED_CLOUD_TYPES: dict[str, str] = {
    "velodyne_msgs/msg/VelodyneScan": _PACKETS_REMEDY,
    "*/msg/PacketMsg": _PACKETS_REMEDY,
    "*/msg/NebulaPackets": _PACKETS_REMEDY,
    "pandar_msgs/msg/*": _PACKETS_REMEDY,
    "hesai_ros_driver/msg/Udp*": _PACKETS_REMEDY,
    "rslidar_msg*/msg/*": _PACKETS_REMEDY,
    "*/msg/CompressedPointCloud2": _COMPRESSED_REMEDY,
    "foxglove_msgs/msg/CompressedPointCloud": _COMPRESSED_REMEDY,
    "sensor_msgs/msg/MultiEchoLaserScan": (
        "Choose one echo with laser_proc, record the LaserScan, and name that topic."
    ),
    "sensor_msgs/msg/PointCloud": (
        "Convert it with point_cloud_converter, record the PointCloud2, and name that topic."
    ),
    "foxglove.*": _PROTOBUF_CLOUD_REMEDY.format("foxglove_msgs/msg/PointCloud"),
}
MAX_POINT_TIME_NS = 10 * NS_PER_S  # between a scan's stamp and a point of it


class LidarPoints(NamedTuple):
    """The returns of a scan.

    xyz: (n, 3) float32, m; ring: (n,), -1 where unknown; dt: (n,), ns after the stamp, zero if
    points have no time; intensity: (n,) float32, NaN where unknown.
    """

    xyz: np.ndarray
    ring: np.ndarray
    dt: np.ndarray
    intensity: np.ndarray


def read_raw_cloud(message: Any) -> RawCloud:
    """Return the returns of a message; raises MessageError if it is damaged."""
    with guard_message_fields(message.__msgtype__):
        cloud = CLOUD_TYPES[message.__msgtype__].read(message)
        return select_cloud_points(cloud, has_return(cloud))


def read_points(message: Any, layout: CloudLayout) -> LidarPoints:
    """Return the returns of a message with their rings and times.

    Raises MessageError if the message is damaged or does not have that layout.
    """
    cloud = read_raw_cloud(message)
    dt = point_times_ns(cloud, layout.point_time)
    largest_ns = max(-dt.min(), dt.max()) if len(dt) else 0
    if largest_ns > MAX_POINT_TIME_NS:
        raise MessageError(
            f"points {largest_ns / NS_PER_S:.1f} s from the stamp of their scan; expected "
            f"{MAX_POINT_TIME_NS // NS_PER_S} s at most. Check point_time and the lidar's clock."
        )
    xyz, ring = stack_xyz(cloud).astype(np.float32), assign_beams(cloud, layout.beams)
    return LidarPoints(xyz, ring, dt, read_intensity(cloud))
