"""foxglove_msgs/PointCloud: a list of points with named fields, in a frame of their own."""

import numpy as np

from calib.io.logs.message_headers import header_stamp_ns
from calib.io.status import MessageError
from calib.sensors.lidar.clouds.pointcloud2 import make_point_dtype, unpad_cloud_rows
from calib.sensors.lidar.clouds.raw_cloud import make_raw_cloud

FOXGLOVE_FIELD_DTYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}


def read(message):
    """Raw of all points, in the message's frame. Raises MessageError where it is damaged."""
    step = message.point_stride
    fields = [(f.name, f.offset, FOXGLOVE_FIELD_DTYPES.get(f.type)) for f in message.fields]
    dtype = make_point_dtype(fields, "<", step)
    shape = 1, len(message.data) // step
    points = unpad_cloud_rows(message.data, *shape, step, 0).view(dtype)[:, 0]
    found = {n: points[n] for n in dtype.names}
    return make_raw_cloud(
        header_stamp_ns(message), found | _transform_points(found, message.pose), shape
    )


def _transform_points(fields, pose):
    """x, y, z by the pose of the points in the message's frame; as they are where it says none."""
    from calib.geometry import se3  # 0.5 s of SciPy, which most logs need not pay

    p, q = pose.position, pose.orientation
    quat = np.array([q.x, q.y, q.z, q.w])
    if not np.isfinite([p.x, p.y, p.z, *quat]).all():
        raise MessageError("a cloud whose pose is no number; the message is damaged")
    T = se3.pose_from_xyz_quat([p.x, p.y, p.z], quat if quat.any() else [0, 0, 0, 1])
    xyz = np.stack([fields[k] for k in "xyz"], -1).astype(float)
    with np.errstate(invalid="ignore"):
        moved = se3.transform_points(T, xyz)
    # The origin marks beams without a return before it is moved.
    moved[~xyz.any(1)] = 0
    return dict(zip("xyz", moved.T, strict=True))
