"""sensor_msgs/CompressedImage and foxglove_msgs/CompressedImage: a JPEG or PNG file."""

import io
from typing import Any

import cv2
import numpy as np
from PIL import Image

from calib.io.safe_names import plain_text
from calib.io.status import MessageError
from calib.sensors.camera.images.pixel_encodings import PIXEL_ENCODINGS, to_eight_bits

# A few bytes may claim to be any number of pixels.
MAX_IMAGE_BYTES = 1 << 28  # of decoded pixels
MAX_PIXELS_PER_BYTE = 8 * 1032  # deflate packs at most 1032 bytes, of 8 pixels each, into one
PNG_BIT_DEPTH_OFFSET = 24
JPEG_END = b"\xff\xd9"
VIDEO_FORMATS = ("h264", "h265", "hevc", "vp9", "av1")
TO_BGR_BY_CHANNELS = {1: cv2.COLOR_GRAY2BGR, 4: cv2.COLOR_BGRA2BGR}


def read(message: Any) -> np.ndarray:
    """Return the image (h, w, 3) uint8, blue green red.

    Raises MessageError if it is neither JPEG nor PNG, or damaged.
    """
    name = message.format.lower()
    if "compresseddepth" in name:
        raise MessageError(
            "images of format compressedDepth hold depths. Name the topic of an image."
        )
    data = np.asarray(message.data, np.uint8)
    _check_image_file(data.tobytes(), message.format)
    # Orientation tags are ignored: calibrated pixels are those of the sensor.
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise MessageError(
            f"an image of format '{plain_text(message.format)}' that cannot be decoded"
        )
    return _to_bgr(image, name)


def _check_image_file(data: bytes, format_name: str) -> None:
    """Raise MessageError unless the bytes begin as an image of a possible size and end as one.

    Decoders fill the missing part of a JPEG with grey, without an error.
    """
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as header:
            (width, height), kind = header.size, header.format
            channels = max(len(header.getbands()), 3 if header.mode == "P" else 1)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        raise MessageError(_describe_unknown_format(format_name)) from None
    sample_bytes = 2 if kind == "PNG" and data[PNG_BIT_DEPTH_OFFSET] == 16 else 1
    if (
        width * height * channels * sample_bytes > MAX_IMAGE_BYTES
        or width * height > MAX_PIXELS_PER_BYTE * len(data)
    ):
        raise MessageError(f"an image that claims {width} x {height} px; the message is damaged")
    if kind == "JPEG" and data.rfind(JPEG_END) < len(data) / 2:
        raise MessageError(f"a JPEG of {width} x {height} px that is cut short")


def _describe_unknown_format(format_name: str) -> str:
    text = f"an image of format '{plain_text(format_name)}' that is neither JPEG nor PNG"
    if any(v in format_name.lower() for v in VIDEO_FORMATS):
        return f"{text}. Republish the video as images, record those, and name their topic."
    return text


def _to_bgr(image: np.ndarray, format_name: str) -> np.ndarray:
    """Return decoded pixels as BGR; image_transport compresses a Bayer mosaic as grey."""
    mosaic = PIXEL_ENCODINGS.get(format_name.split(";")[0].strip())
    if image.ndim == 2 and format_name.startswith("bayer") and mosaic:
        return mosaic.to_bgr(image)
    image = to_eight_bits(image)
    channels = 1 if image.ndim == 2 else image.shape[2]
    code = TO_BGR_BY_CHANNELS.get(channels)
    return image if code is None else cv2.cvtColor(image, code)
