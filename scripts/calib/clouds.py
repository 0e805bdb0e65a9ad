"""PointCloud2 messages as arrays."""

import numpy as np

from calib.status import InputError

TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
TIMES = {"time": ("f4", 1e9), "t": ("u4", 1.0), "time_stamp": ("u4", 1.0)}
RINGS = ("ring", "channel", "line")


def points(message):
    """xyz (n, 3) float32, m; ring (n,), -1 where unknown; dt (n,), ns after the stamp.

    Points that are not finite or lie at the origin, as drivers mark beams without a return, are
    left out. Raises InputError where x, y, z are missing.
    """
    cloud = _structured(message)
    names = cloud.dtype.names
    if not {"x", "y", "z"} <= set(names):
        raise InputError(f"a cloud without x, y, z: its fields are {', '.join(names)}")
    xyz = np.stack([cloud[k].astype(np.float32) for k in "xyz"], -1)
    seen = np.isfinite(xyz).all(1) & (xyz != 0).any(1)
    return xyz[seen], _ring(cloud)[seen], _time(cloud)[seen]


def _structured(message):
    order = ">" if message.is_bigendian else "<"
    dtype = np.dtype(
        {
            "names": [f.name for f in message.fields],
            "formats": [order + TYPES[f.datatype] for f in message.fields],
            "offsets": [f.offset for f in message.fields],
            "itemsize": message.point_step,
        }
    )
    data = np.asarray(message.data, np.uint8)
    rows = data.reshape(message.height, message.row_step)[:, : message.width * message.point_step]
    return np.ascontiguousarray(rows).reshape(-1).view(dtype)


def _ring(cloud):
    for name in RINGS:
        if name in cloud.dtype.names:
            return cloud[name].astype(np.int32)
    return np.full(len(cloud), -1, np.int32)


def _time(cloud):
    """Relative times of the drivers' own field and type; zero where a cloud has none."""
    for name, (kind, to_ns) in TIMES.items():
        if name in cloud.dtype.names and cloud.dtype[name].newbyteorder("=").str[1:] == kind:
            return np.round(cloud[name].astype(float) * to_ns).astype(np.int64)
    return np.zeros(len(cloud), np.int64)
