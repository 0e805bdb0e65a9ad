"""How pixels lie in memory, by the names that ROS and Foxglove give.

To add an encoding: one line in ENCODINGS; a family is what has a function of its own here.
"""

from functools import partial
from typing import NamedTuple

import cv2
import numpy as np

from calib.io.status import MessageError

BIT_DEPTHS = (8, 10, 12, 14)  # bits of cameras, beside 16


class PixelEncoding(NamedTuple):
    """Type and channels of a pixel; rows of the buffer for two of the image; what makes
    (rows, width[, channels]) of that type to (h, w, 3) uint8, blue green red."""

    dtype: str
    channels: int
    rows_per_two_lines: int
    to_bgr: object


def to_eight_bits(pixels):
    """Pixels as uint8: of 16 bits as many are taken off as the image does not need, for cameras of
    10 or 12 bits seldom say so."""
    if pixels.dtype == np.uint8:
        return pixels
    used = next((d for d in BIT_DEPTHS if int(pixels.max(initial=0)) < 1 << d), 16)
    return (pixels >> (used - 8)).astype(np.uint8)


def _convert_color(code, pixels):
    pixels = to_eight_bits(pixels)
    return np.ascontiguousarray(pixels) if code is None else cv2.cvtColor(pixels, code)


def _demosaic(code, pixels):
    """Colours by variable gradients: corners are then four times nearer to where they are than by
    the mean of the neighbours."""
    if min(pixels.shape) < 2:
        raise MessageError("a Bayer image of less than 2 x 2 px; the message is damaged")
    return cv2.cvtColor(to_eight_bits(pixels), code)


def _convert_yuv(code, pixels):
    """Two pixels of a row share their colour, or four of two rows: then brightness comes first."""
    if pixels.shape[1] % 2 or (pixels.ndim == 2 and pixels.shape[0] % 3):
        raise MessageError("a YUV image of odd width or height; the message is damaged")
    return cv2.cvtColor(pixels, code)


def _make_encodings(function, dtype, channels, rows=2, **codes):
    made = {k: PixelEncoding(dtype, channels, rows, partial(function, c)) for k, c in codes.items()}
    return {k.removeprefix("_"): e for k, e in made.items()}


BAYER_CODES = {
    "rggb": cv2.COLOR_BayerRGGB2BGR_VNG,
    "bggr": cv2.COLOR_BayerBGGR2BGR_VNG,
    "gbrg": cv2.COLOR_BayerGBRG2BGR_VNG,
    "grbg": cv2.COLOR_BayerGRBG2BGR_VNG,
}
# A name that begins with a digit has a _ before it.
PIXEL_ENCODINGS = {
    **_make_encodings(_convert_color, "u1", 1, mono8=cv2.COLOR_GRAY2BGR, _8UC1=cv2.COLOR_GRAY2BGR),
    **_make_encodings(_convert_color, "u2", 1, mono16=cv2.COLOR_GRAY2BGR, _16UC1=cv2.COLOR_GRAY2BGR),
    **_make_encodings(_convert_color, "u1", 3, bgr8=None, _8UC3=None, rgb8=cv2.COLOR_RGB2BGR),
    **_make_encodings(_convert_color, "u2", 3, bgr16=None, _16UC3=None, rgb16=cv2.COLOR_RGB2BGR),
    **_make_encodings(_convert_color, "u1", 4, bgra8=cv2.COLOR_BGRA2BGR, _8UC4=cv2.COLOR_BGRA2BGR,
              rgba8=cv2.COLOR_RGBA2BGR),
    **_make_encodings(_convert_color, "u2", 4, bgra16=cv2.COLOR_BGRA2BGR, _16UC4=cv2.COLOR_BGRA2BGR,
              rgba16=cv2.COLOR_RGBA2BGR),
    **_make_encodings(_demosaic, "u1", 1, **{f"bayer_{k}8": v for k, v in BAYER_CODES.items()}),
    **_make_encodings(_demosaic, "u2", 1, **{f"bayer_{k}16": v for k, v in BAYER_CODES.items()}),
    **_make_encodings(_convert_yuv, "u1", 2, yuv422=cv2.COLOR_YUV2BGR_UYVY, uyvy=cv2.COLOR_YUV2BGR_UYVY,
              yuv422_yuy2=cv2.COLOR_YUV2BGR_YUY2, yuyv=cv2.COLOR_YUV2BGR_YUY2),
    **_make_encodings(_convert_yuv, "u1", 1, 3, nv12=cv2.COLOR_YUV2BGR_NV12, nv21=cv2.COLOR_YUV2BGR_NV21),
}  # fmt: skip
