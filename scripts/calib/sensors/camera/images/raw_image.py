"""sensor_msgs/Image and foxglove_msgs/RawImage: pixels as they lie in memory."""

import numpy as np

from calib.io.status import MessageError
from calib.sensors.camera.images.pixel_encodings import PIXEL_ENCODINGS


def read(message):
    """(h, w, 3) uint8, blue green red. Raises MessageError for an encoding that is not read, and
    where the data do not hold the image."""
    encoding = PIXEL_ENCODINGS.get(message.encoding)
    if encoding is None:
        raise MessageError(
            f"images encoded {message.encoding}; this version reads {', '.join(PIXEL_ENCODINGS)}: "
            "convert the topic with image_proc and record it again"
        )
    # Foxglove's are always little-endian.
    order = ">" if getattr(message, "is_bigendian", False) else "<"
    return encoding.to_bgr(_unpad_pixels(message, encoding, np.dtype(order + encoding.dtype)))


def _unpad_pixels(message, encoding, dtype):
    """(rows, width[, channels]) of native byte order, without the padding of rows."""
    width, step = message.width, message.step
    rows, used = (
        message.height * encoding.rows_per_two_lines // 2,
        width * encoding.channels * dtype.itemsize,
    )
    data = np.asarray(message.data, np.uint8)
    # The last row may do without its padding.
    if not rows * used or step < used or (rows - 1) * step + used > len(data):
        raise MessageError(
            f"an image of {width} x {message.height} px, {message.encoding}, with rows of {step} "
            f"bytes and {len(data)} in all; the message is damaged"
        )
    data = np.ascontiguousarray(data)
    lines = np.lib.stride_tricks.as_strided(data, (rows, used), (step, 1), writeable=False)
    lines = np.ascontiguousarray(lines)
    pixels = lines.view(dtype).astype(dtype.newbyteorder("="), copy=False)
    shape = (rows, width) if encoding.channels == 1 else (rows, width, encoding.channels)
    return pixels.reshape(shape)
