"""sensor_msgs/Image and foxglove_msgs/RawImage: pixels as they lie in memory."""

from typing import Any

import numpy as np

from calib.io.safe_names import plain_text
from calib.io.status import MessageError
from calib.sensors.camera.images.pixel_encodings import PIXEL_ENCODINGS, PixelEncoding


def read(message: Any) -> np.ndarray:
    """Return the image (h, w, 3) uint8, blue green red.

    Raises MessageError if the encoding is not supported or the data do not hold the image.
    """
    encoding = PIXEL_ENCODINGS.get(message.encoding)
    if encoding is None:
        raise MessageError(
            f"image encoding {plain_text(message.encoding)} is not supported; expected one of "
            f"{', '.join(PIXEL_ENCODINGS)}. Convert the topic with image_proc and record it again."
        )
    # Foxglove's are always little-endian.
    order = ">" if getattr(message, "is_bigendian", False) else "<"
    return encoding.to_bgr(_unpad_pixels(message, encoding, np.dtype(order + encoding.dtype)))


def _unpad_pixels(message: Any, encoding: PixelEncoding, dtype: np.dtype) -> np.ndarray:
    """Return the pixels (rows, width[, channels]) in native byte order, without row padding."""
    width, step = message.width, message.step
    rows = message.height * encoding.rows_per_two_lines // 2
    row_bytes = width * encoding.channels * dtype.itemsize
    data = np.asarray(message.data, np.uint8)
    # The last row may lack its padding.
    if not rows * row_bytes or step < row_bytes or (rows - 1) * step + row_bytes > len(data):
        raise MessageError(
            f"an image of {width} x {message.height} px, {plain_text(message.encoding)}, with "
            f"rows of {step} bytes and {len(data)} in all; the message is damaged"
        )
    data = np.ascontiguousarray(data)
    lines = np.lib.stride_tricks.as_strided(data, (rows, row_bytes), (step, 1), writeable=False)
    lines = np.ascontiguousarray(lines)
    pixels = lines.view(dtype).astype(dtype.newbyteorder("="), copy=False)
    shape = (rows, width) if encoding.channels == 1 else (rows, width, encoding.channels)
    return pixels.reshape(shape)
