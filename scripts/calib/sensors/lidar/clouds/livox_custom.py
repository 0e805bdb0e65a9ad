"""CustomMsg of livox_ros_driver and livox_ros_driver2: points with times after a time base."""

from typing import Any

import numpy as np

from calib.io.logs.message_headers import header_stamp_ns
from calib.sensors.lidar.clouds.raw_cloud import RawCloud, make_raw_cloud

LIVOX_POINT_DTYPES = {
    "x": "f4",
    "y": "f4",
    "z": "f4",
    "line": "u1",
    "reflectivity": "u1",
    "offset_time": "i8",
}


def read(message: Any) -> RawCloud:
    """Return all points; offset_time is on the clock of the time base, ns."""
    n = len(message.points)
    fields = {k: message.points[k].astype(t) for k, t in LIVOX_POINT_DTYPES.items()}
    # Hostile values wrap around and are rejected as too far from the stamp.
    fields["offset_time"] += np.uint64(message.timebase).astype(np.int64)
    return make_raw_cloud(header_stamp_ns(message), fields, (1, n))
