"""foxglove_msgs/PointCloud: a list of points with named fields, in a frame of their own."""

import numpy as np

from calib.io.logs import message_headers
from calib.io.status import MessageError
from calib.sensors.lidar.clouds import pointcloud2, raw_cloud

TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}


def read(message):
    """Raw of all points, in the message's frame. Raises MessageError where it is damaged."""
    step = message.point_stride
    fields = [(f.name, f.offset, TYPES.get(f.type)) for f in message.fields]
    dtype = pointcloud2.layout(fields, "<", step)
    shape = 1, len(message.data) // step
    points = pointcloud2.rows(message.data, *shape, step, 0).view(dtype)[:, 0]
    found = {n: points[n] for n in dtype.names}
    return raw_cloud.of(
        message_headers.stamp_ns(message), found | _placed(found, message.pose), shape
    )


def _placed(fields, pose):
    """x, y, z by the pose of the points in the message's frame; as they are where it says none."""
    from calib.geometry import se3  # 0.5 s of SciPy, which most logs need not pay

    p, q = pose.position, pose.orientation
    quat = np.array([q.x, q.y, q.z, q.w])
    if not np.isfinite([p.x, p.y, p.z, *quat]).all():
        raise MessageError("a cloud whose pose is no number; the message is damaged")
    T = se3.from_xyz_quat([p.x, p.y, p.z], quat if quat.any() else [0, 0, 0, 1])
    xyz = np.stack([fields[k] for k in "xyz"], -1).astype(float)
    with np.errstate(invalid="ignore"):
        moved = se3.transform(T, xyz)
    # The origin marks beams without a return before it is moved.
    moved[~xyz.any(1)] = 0
    return dict(zip("xyz", moved.T, strict=True))
