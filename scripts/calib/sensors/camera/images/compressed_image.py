"""sensor_msgs/CompressedImage and foxglove_msgs/CompressedImage: a JPEG or PNG file."""

import io

import cv2
import numpy as np
from PIL import Image

from calib.io.status import MessageError
from calib.sensors.camera.images.pixel_encodings import PIXEL_ENCODINGS, to_eight_bits

MAX_IMAGE_PIXELS = 1 << 27  # of an image; a few bytes may claim to be any number
JPEG_END = b"\xff\xd9"
VIDEO_FORMATS = ("h264", "h265", "hevc", "vp9", "av1")
TO_BGR_BY_CHANNELS = {1: cv2.COLOR_GRAY2BGR, 4: cv2.COLOR_BGRA2BGR}


def read(message):
    """(h, w, 3) uint8, blue green red. Raises MessageError for what is neither JPEG nor PNG, and
    where the file is damaged."""
    name = message.format.lower()
    if "compresseddepth" in name:
        raise MessageError("images of format compressedDepth hold depths; name an image's topic")
    data = np.asarray(message.data, np.uint8)
    _check_image_file(data.tobytes(), message.format)
    # Orientation tags are ignored: calibrated pixels are those of the sensor.
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise MessageError(f"an image of format {message.format!r} that cannot be decoded")
    return _to_bgr(image, name)


def _check_image_file(data, name):
    """Raise MessageError unless the bytes begin as an image of a size that can be, and end as one.

    Decoders fill what is missing of a JPEG with grey, and say nothing.
    """
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as header:
            (width, height), kind = header.size, header.format
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        raise MessageError(_describe_unknown_format(name)) from None
    if width * height > MAX_IMAGE_PIXELS:
        raise MessageError(f"an image that claims {width} x {height} px; the message is damaged")
    if kind == "JPEG" and data.rfind(JPEG_END) < len(data) / 2:
        raise MessageError(f"a JPEG of {width} x {height} px that is cut short")


def _describe_unknown_format(name):
    words = f"an image of format {name!r} that is neither JPEG nor PNG"
    if any(v in name.lower() for v in VIDEO_FORMATS):
        return f"{words}: republish the video as images, record those, and name their topic"
    return words


def _to_bgr(image, name):
    """Decoded pixels in blue green red; image_transport compresses a Bayer mosaic as grey."""
    mosaic = PIXEL_ENCODINGS.get(name.split(";")[0].strip())
    if image.ndim == 2 and name.startswith("bayer") and mosaic:
        return mosaic.to_bgr(image)
    image = to_eight_bits(image)
    channels = 1 if image.ndim == 2 else image.shape[2]
    return (
        cv2.cvtColor(image, TO_BGR_BY_CHANNELS[channels])
        if channels in TO_BGR_BY_CHANNELS
        else image
    )
