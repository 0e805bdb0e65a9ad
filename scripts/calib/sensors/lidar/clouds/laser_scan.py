"""sensor_msgs/LaserScan: ranges of a 2-D scanner in the x-y plane of its frame."""

from typing import Any

import numpy as np

from calib.io.logs.message_headers import header_stamp_ns
from calib.sensors.lidar.clouds.raw_cloud import RawCloud, make_raw_cloud


def read(message: Any) -> RawCloud:
    """Return all beams, with their intensity and time_increment, s after the stamp, if stated."""
    ranges = np.asarray(message.ranges, float)
    n = len(ranges)
    angle = np.nan_to_num(message.angle_min + message.angle_increment * np.arange(n))
    is_return = (ranges >= message.range_min) & (ranges <= message.range_max) & (ranges > 0)
    ranges = np.where(is_return, ranges, 0.0)
    fields = {
        "x": ranges * np.cos(angle),
        "y": ranges * np.sin(angle),
        "z": np.zeros(n),
        "ring": np.zeros(n, np.int32),
    }
    if len(message.intensities) == n:
        fields["intensity"] = np.asarray(message.intensities, float)
    if message.time_increment:
        fields["time_increment"] = message.time_increment * np.arange(n)
    return make_raw_cloud(header_stamp_ns(message), fields, (1, n))
