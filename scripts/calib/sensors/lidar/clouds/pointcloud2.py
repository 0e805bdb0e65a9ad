"""sensor_msgs/PointCloud2, as PCL and the drivers fill it: organised or not, padded, big-endian."""

from typing import Any, NamedTuple

import numpy as np

from calib.io.logs.message_headers import header_stamp_ns
from calib.io.safe_names import safe_name
from calib.io.status import MessageError
from calib.sensors.lidar.clouds.raw_cloud import RawCloud, make_raw_cloud

MAX_POINT_BYTES = 1 << 16
POINT_FIELD_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


class PointField(NamedTuple):
    """A field of a point: name, offset in bytes, dtype without byte order (None if unknown)."""

    name: str
    offset: int
    dtype: str | None


def read(message: Any) -> RawCloud:
    """Return all beams; raises MessageError if x, y, z or the points themselves are missing."""
    order = ">" if message.is_bigendian else "<"
    fields = [
        PointField(safe_name(f.name), f.offset, POINT_FIELD_DTYPES.get(f.datatype))
        for f in message.fields
    ]
    dtype = make_point_dtype(fields, order, message.point_step)
    shape = message.height, message.width
    rows = unpad_cloud_rows(
        message.data, *shape, point_step=message.point_step, row_step=message.row_step
    )
    points = rows.view(dtype)[:, 0]
    values = {n: points[n] for n in dtype.names or ()}
    return make_raw_cloud(header_stamp_ns(message), values, shape)


def make_point_dtype(fields: list[PointField], order: str, point_step: int) -> np.dtype:
    """Return the dtype of points of point_step bytes; order is "<" or ">".

    Fields that cannot be read are left out, as they may not be needed; x, y, z must be there.
    """
    if point_step > MAX_POINT_BYTES:
        raise MessageError(f"a cloud of points of {point_step} bytes; the message is damaged")
    readable: dict[str, tuple[str, int]] = {}
    for name, offset, kind in fields:
        if kind is None or not name or name in readable:
            continue
        if 0 <= offset <= point_step - np.dtype(kind).itemsize:
            readable[name] = order + kind, offset
    missing = [k for k in "xyz" if k not in readable]
    if missing:
        names = [f.name for f in fields]
        if set(missing) & set(names):
            raise MessageError(
                f"a cloud whose {missing[0]} does not fit into its points of {point_step} bytes; "
                "the message is damaged"
            )
        raise MessageError(f"a cloud without x, y, z: its fields are {', '.join(names)}")
    formats, offsets = zip(*readable.values(), strict=True)
    return np.dtype(
        {"names": list(readable), "formats": formats, "offsets": offsets, "itemsize": point_step}
    )


def unpad_cloud_rows(
    data: np.ndarray, height: int, width: int, *, point_step: int, row_step: int
) -> np.ndarray:
    """Return the bytes (height * width, point_step) of a cloud without the padding of its rows.

    Some drivers leave row_step at zero: rows then follow each other.
    """
    data, row_bytes = np.ascontiguousarray(data, np.uint8), width * point_step
    row_step = row_step if height > 1 and row_step >= row_bytes else row_bytes
    n_bytes = (height - 1) * row_step + row_bytes if height else 0
    if n_bytes > len(data):
        raise MessageError(
            f"a cloud of {height} x {width} points of {point_step} bytes takes {n_bytes} bytes and "
            f"has {len(data)}; the message is damaged"
        )
    if not height * width:
        return np.zeros((0, point_step), np.uint8)
    lines = np.lib.stride_tricks.as_strided(
        data, (height, row_bytes), (row_step, 1), writeable=False
    )
    return np.ascontiguousarray(lines).reshape(-1, point_step)
