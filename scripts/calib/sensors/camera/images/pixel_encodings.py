"""How pixels lie in memory, by the names of ROS and Foxglove.

To add an encoding: one line in PIXEL_ENCODINGS; a family has a function of its own here. The
package rosbags-image is not used: it ignores the padding of rows, scales 12 bits in 16 to nearly
black, and demosaics Bayer images by the mean of the neighbours.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np

from calib.io.status import MessageError

CAMERA_BIT_DEPTHS = (8, 10, 12, 14)  # beside 16
ColorCode = int | None  # of cv2.cvtColor; None: the pixels are BGR already


class PixelEncoding(NamedTuple):
    """Layout of the pixels of an encoding.

    dtype, channels: of a pixel; rows_per_two_lines: rows of the buffer for two lines of the image;
    to_bgr: makes (h, w, 3) uint8, blue green red, of (rows, width[, channels]) of that type.
    """

    dtype: str
    channels: int
    rows_per_two_lines: int
    to_bgr: Callable[[np.ndarray], np.ndarray]


def to_eight_bits(pixels: np.ndarray) -> np.ndarray:
    """Return pixels as uint8; of 16 bits the lowest are dropped, as many as the image allows.

    Cameras of 10 or 12 bits seldom say so, so the depth is that of the brightest pixel.
    """
    if pixels.dtype == np.uint8:
        return pixels
    brightest = int(pixels.max(initial=0))
    depth = next((d for d in CAMERA_BIT_DEPTHS if brightest < 1 << d), 16)
    return (pixels >> (depth - 8)).astype(np.uint8)


def _convert_color(code: ColorCode, pixels: np.ndarray) -> np.ndarray:
    """Convert grey or colour pixels to BGR."""
    pixels = to_eight_bits(pixels)
    return np.ascontiguousarray(pixels) if code is None else cv2.cvtColor(pixels, code)


def _demosaic(code: int, pixels: np.ndarray) -> np.ndarray:
    """Convert a Bayer mosaic by variable gradients.

    Corners are then four times nearer to the truth than by the mean of the neighbours.
    """
    if min(pixels.shape) < 2:
        raise MessageError("a Bayer image of less than 2 x 2 px; the message is damaged")
    return cv2.cvtColor(to_eight_bits(pixels), code)


def _convert_yuv(code: int, pixels: np.ndarray) -> np.ndarray:
    """Convert YUV pixels: two of a row share their colour, or four of two rows."""
    if pixels.shape[1] % 2 or (pixels.ndim == 2 and pixels.shape[0] % 3):
        raise MessageError("a YUV image of odd width or height; the message is damaged")
    return cv2.cvtColor(pixels, code)


def _make_encodings(
    convert: Callable[..., np.ndarray],
    dtype: str,
    channels: int,
    codes: dict[str, ColorCode],
    rows_per_two_lines: int = 2,
) -> dict[str, PixelEncoding]:
    """Return encodings by name that share all but the colour code."""
    return {
        name: PixelEncoding(dtype, channels, rows_per_two_lines, partial(convert, code))
        for name, code in codes.items()
    }


GREY, RGB, BGRA, RGBA = (
    cv2.COLOR_GRAY2BGR,
    cv2.COLOR_RGB2BGR,
    cv2.COLOR_BGRA2BGR,
    cv2.COLOR_RGBA2BGR,
)
BAYER_CODES = {
    "rggb": cv2.COLOR_BayerRGGB2BGR_VNG,
    "bggr": cv2.COLOR_BayerBGGR2BGR_VNG,
    "gbrg": cv2.COLOR_BayerGBRG2BGR_VNG,
    "grbg": cv2.COLOR_BayerGRBG2BGR_VNG,
}
YUV422_CODES = {
    "yuv422": cv2.COLOR_YUV2BGR_UYVY,
    "uyvy": cv2.COLOR_YUV2BGR_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2,
    "yuyv": cv2.COLOR_YUV2BGR_YUY2,
}
YUV420_CODES = {"nv12": cv2.COLOR_YUV2BGR_NV12, "nv21": cv2.COLOR_YUV2BGR_NV21}
PIXEL_ENCODINGS: dict[str, PixelEncoding] = {
    **_make_encodings(_convert_color, "u1", 1, {"mono8": GREY, "8UC1": GREY}),
    **_make_encodings(_convert_color, "u2", 1, {"mono16": GREY, "16UC1": GREY}),
    **_make_encodings(_convert_color, "u1", 3, {"bgr8": None, "8UC3": None, "rgb8": RGB}),
    **_make_encodings(_convert_color, "u2", 3, {"bgr16": None, "16UC3": None, "rgb16": RGB}),
    **_make_encodings(_convert_color, "u1", 4, {"bgra8": BGRA, "8UC4": BGRA, "rgba8": RGBA}),
    **_make_encodings(_convert_color, "u2", 4, {"bgra16": BGRA, "16UC4": BGRA, "rgba16": RGBA}),
    **_make_encodings(_demosaic, "u1", 1, {f"bayer_{k}8": c for k, c in BAYER_CODES.items()}),
    **_make_encodings(_demosaic, "u2", 1, {f"bayer_{k}16": c for k, c in BAYER_CODES.items()}),
    **_make_encodings(_convert_yuv, "u1", 2, {**YUV422_CODES}),
    **_make_encodings(_convert_yuv, "u1", 1, {**YUV420_CODES}, rows_per_two_lines=3),
}
