"""Messages of lidars as arrays.

A type of message is one module with read(message) -> raw.Raw. To add one: write
calib/sensors/lidar/clouds/<name>.py and add it to TYPES. Which field holds the time of a point and
which its ring, no message says: `layout.infer` finds it out of a few and puts it in words.
"""

import numpy as np

from calib.geometry.units import NS_PER_S
from calib.io.status import MessageError, guard_message_fields
from calib.sensors.lidar.clouds import foxglove_cloud, laser_scan, livox_custom, pointcloud2
from calib.sensors.lidar.clouds.beam_inference import assign_beams
from calib.sensors.lidar.clouds.point_time_inference import point_times_ns
from calib.sensors.lidar.clouds.raw_cloud import has_return, select_cloud_points, stack_xyz

CLOUD_TYPES = {
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
# Types that are known and not read, by pattern (fnmatch): what to do.
UNSUPPORTED_CLOUD_TYPES = {
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
MAX_POINT_TIME_NS = 10 * NS_PER_S  # from its stamp that a point of a scan can have been measured


def read_raw_cloud(message):
    """The raw.Raw of a message, only its returns. Raises MessageError where it is damaged."""
    with guard_message_fields(message.__msgtype__):
        whole = CLOUD_TYPES[message.__msgtype__].read(message)
        return select_cloud_points(whole, has_return(whole))


def read_points(message, layout):
    """xyz (n, 3) float32, m; ring (n,), -1 where unknown; dt (n,), ns after the stamp, zero where
    the layout knows of no time.

    Beams without a return, in whichever way drivers mark them, are left out. Raises MessageError
    where the message is damaged or not of that layout.
    """
    cloud = read_raw_cloud(message)
    dt = point_times_ns(cloud, layout.point_time)
    if len(dt) and max(-dt.min(), dt.max()) > MAX_POINT_TIME_NS:
        raise MessageError(
            f"points {max(-dt.min(), dt.max()) / NS_PER_S:.1f} s from the stamp of their scan; "
            "check point_time and the lidar's clock"
        )
    return stack_xyz(cloud).astype(np.float32), assign_beams(cloud, layout.beams), dt
