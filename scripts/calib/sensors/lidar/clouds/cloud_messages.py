"""Messages of lidars as arrays.

A type of message is one module with read(message) -> raw.Raw. To add one: write
calib/sensors/lidar/clouds/<name>.py and add it to TYPES. Which field holds the time of a point and
which its ring, no message says: `layout.infer` finds it out of a few and puts it in words.
"""

import numpy as np

from calib.io.status import MessageError, as_defined
from calib.sensors.lidar.clouds import (
    beam_inference,
    foxglove_cloud,
    laser_scan,
    livox_custom,
    point_time_inference,
    pointcloud2,
    raw_cloud,
)

TYPES = {
    "sensor_msgs/msg/PointCloud2": pointcloud2,
    "livox_ros_driver/msg/CustomMsg": livox_custom,
    "livox_ros_driver2/msg/CustomMsg": livox_custom,
    "sensor_msgs/msg/LaserScan": laser_scan,
    "foxglove_msgs/msg/PointCloud": foxglove_cloud,
}

_PACKETS = (
    "These are the lidar's packets. Replay the log through its driver, record the PointCloud2 that "
    "the driver publishes, and name that topic."
)
_COMPRESSED = (
    "Decompress it with `ros2 run point_cloud_transport republish`, record the PointCloud2, and "
    "name that topic."
)
_PROTOBUF = "Write it as {0} in ROS encoding (CDR), or record the driver's own ROS topic."
# Types that are known and not read, by pattern (fnmatch): what to do.
REFUSED = {
    "velodyne_msgs/msg/VelodyneScan": _PACKETS,
    "*/msg/PacketMsg": _PACKETS,
    "*/msg/NebulaPackets": _PACKETS,
    "pandar_msgs/msg/*": _PACKETS,
    "hesai_ros_driver/msg/Udp*": _PACKETS,
    "rslidar_msg*/msg/*": _PACKETS,
    "*/msg/CompressedPointCloud2": _COMPRESSED,
    "foxglove_msgs/msg/CompressedPointCloud": _COMPRESSED,
    "sensor_msgs/msg/MultiEchoLaserScan": (
        "Choose one echo with laser_proc, record the LaserScan, and name that topic."
    ),
    "sensor_msgs/msg/PointCloud": (
        "Convert it with point_cloud_converter, record the PointCloud2, and name that topic."
    ),
    "foxglove.*": _PROTOBUF.format("foxglove_msgs/msg/PointCloud"),
}
FARTHEST_NS = 10 * 10**9  # from its stamp that a point of a scan can have been measured


def read(message):
    """The raw.Raw of a message, only its returns. Raises MessageError where it is damaged."""
    with as_defined(message.__msgtype__):
        whole = TYPES[message.__msgtype__].read(message)
        return raw_cloud.select(whole, raw_cloud.returned(whole))


def points(message, layout):
    """xyz (n, 3) float32, m; ring (n,), -1 where unknown; dt (n,), ns after the stamp, zero where
    the layout knows of no time.

    Beams without a return, in whichever way drivers mark them, are left out. Raises MessageError
    where the message is damaged or not of that layout.
    """
    cloud = read(message)
    dt = point_time_inference.after(cloud, layout.time)
    if len(dt) and max(-dt.min(), dt.max()) > FARTHEST_NS:
        raise MessageError(
            f"points {max(-dt.min(), dt.max()) / 1e9:.1f} s from the stamp of their scan; "
            "check point_time and the lidar's clock"
        )
    return raw_cloud.xyz(cloud).astype(np.float32), beam_inference.of(cloud, layout.ring), dt
