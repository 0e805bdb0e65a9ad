"""sensor_msgs/PointCloud2, as PCL and the drivers fill it: organised or not, padded, big-endian."""

import numpy as np

from calib.io.logs.message_headers import header_stamp_ns
from calib.io.status import MessageError
from calib.sensors.lidar.clouds.raw_cloud import make_raw_cloud

MAX_POINT_BYTES = 1 << 16  # bytes of a point
POINT_FIELD_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def read(message):
    """Raw of all beams. Raises MessageError where x, y, z or the points themselves are missing."""
    order = ">" if message.is_bigendian else "<"
    fields = [(f.name, f.offset, POINT_FIELD_DTYPES.get(f.datatype)) for f in message.fields]
    dtype = make_point_dtype(fields, order, message.point_step)
    shape = message.height, message.width
    points = unpad_cloud_rows(message.data, *shape, message.point_step, message.row_step).view(
        dtype
    )[:, 0]
    return make_raw_cloud(header_stamp_ns(message), {n: points[n] for n in dtype.names}, shape)


def make_point_dtype(fields, order, step):
    """dtype of points of step bytes with fields [(name, offset, format or None if unknown)].

    What cannot be read is left out, for it may never be wanted; only x, y, z must be there.
    """
    if step > MAX_POINT_BYTES:
        raise MessageError(f"a cloud of points of {step} bytes; the message is damaged")
    known = {}
    for name, offset, kind in fields:
        fits = kind is not None and 0 <= offset <= step - np.dtype(kind).itemsize
        if name and fits and name not in known:
            known[name] = order + kind, offset
    missing = [k for k in "xyz" if k not in known]
    if missing:
        names = [n for n, _, _ in fields]
        if set(missing) & set(names):
            raise MessageError(
                f"a cloud whose {missing[0]} does not fit into its points of {step} bytes; "
                "the message is damaged"
            )
        raise MessageError(f"a cloud without x, y, z: its fields are {', '.join(names)}")
    formats, offsets = zip(*known.values(), strict=True)
    return np.dtype(
        {"names": list(known), "formats": formats, "offsets": offsets, "itemsize": step}
    )


def unpad_cloud_rows(data, height, width, step, row_step):
    """(height * width, step) uint8 of an organised cloud without the padding of its rows.

    Some drivers leave row_step at zero: rows then follow each other.
    """
    data, used = np.ascontiguousarray(data, np.uint8), width * step
    row_step = row_step if height > 1 and row_step >= used else used
    wanted = (height - 1) * row_step + used if height else 0
    if wanted > len(data):
        raise MessageError(
            f"a cloud of {height} x {width} points of {step} bytes takes {wanted} bytes and has "
            f"{len(data)}; the message is damaged"
        )
    if not height * width:
        return np.zeros((0, step), np.uint8)
    lines = np.lib.stride_tricks.as_strided(data, (height, used), (row_step, 1), writeable=False)
    return np.ascontiguousarray(lines).reshape(-1, step)
