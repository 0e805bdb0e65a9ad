"""foxglove_msgs/PointCloud: a list of points with named fields, in a frame of their own."""

from typing import Any

import numpy as np

from calib.io.logs.message_headers import header_stamp_ns
from calib.io.safe_names import safe_name
from calib.io.status import MessageError
from calib.sensors.lidar.clouds.pointcloud2 import PointField, make_point_dtype, unpad_cloud_rows
from calib.sensors.lidar.clouds.raw_cloud import RawCloud, make_raw_cloud

FOXGLOVE_FIELD_DTYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}


def read(message: Any) -> RawCloud:
    """Return all points, in the message's frame; raises MessageError if it is damaged."""
    step = message.point_stride
    fields = [
        PointField(safe_name(f.name), f.offset, FOXGLOVE_FIELD_DTYPES.get(f.type))
        for f in message.fields
    ]
    dtype = make_point_dtype(fields, "<", step)
    shape = 1, len(message.data) // step
    rows = unpad_cloud_rows(message.data, *shape, point_step=step, row_step=0)
    points = rows.view(dtype)[:, 0]
    values = {n: points[n] for n in dtype.names or ()}
    return make_raw_cloud(
        header_stamp_ns(message), values | _transform_points(values, message.pose), shape
    )


def _transform_points(fields: dict[str, np.ndarray], pose: Any) -> dict[str, np.ndarray]:
    """Return x, y, z moved by the pose of the points in the message's frame, if it has one."""
    from calib.geometry import se3  # 0.5 s of SciPy, which most logs need not pay

    p, q = pose.position, pose.orientation
    quat = np.array([q.x, q.y, q.z, q.w])
    if not np.isfinite([p.x, p.y, p.z, *quat]).all():
        raise MessageError("a cloud whose pose is not finite; the message is damaged")
    T = se3.pose_from_xyz_quat([p.x, p.y, p.z], quat if quat.any() else [0, 0, 0, 1])
    xyz = np.stack([fields[k] for k in "xyz"], -1).astype(float)
    with np.errstate(invalid="ignore"):
        moved = se3.transform_points(T, xyz)
    # Points at the origin mark beams without a return; the pose would move them.
    moved[~xyz.any(1)] = 0
    return dict(zip("xyz", moved.T, strict=True))
