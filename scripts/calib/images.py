"""Image and CompressedImage messages as arrays, and regions of them as lossless bytes."""

import cv2
import numpy as np

from calib.status import InputError

# encoding: bytes per pixel, how OpenCV brings it to BGR
ENCODINGS = {
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "8UC1": (1, cv2.COLOR_GRAY2BGR),
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
}


def bgr(message):
    """(h, w, 3) uint8 of an Image or CompressedImage message.

    Raises InputError for an encoding that this version does not read.
    """
    if hasattr(message, "format"):
        return _decompress(message)
    if message.encoding not in ENCODINGS:
        raise InputError(
            f"images encoded {message.encoding}; this version reads {', '.join(ENCODINGS)}: "
            "convert the topic with image_proc and record it again"
        )
    channels, code = ENCODINGS[message.encoding]
    rows = np.asarray(message.data, np.uint8).reshape(message.height, message.step)
    image = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    return np.ascontiguousarray(image) if code is None else cv2.cvtColor(image, code)


def _decompress(message):
    # Orientation tags are ignored: calibrated pixels are those of the sensor.
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    data = np.asarray(message.data, np.uint8)
    image = cv2.imdecode(data, flags) if len(data) else None
    if image is None:
        raise InputError(f"an image of format {message.format!r} that is neither JPEG nor PNG")
    return image


def grey(image):
    """(h, w) uint8 of a (h, w, 3) uint8 image."""
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def to_png(image):
    """PNG bytes of (h, w, 3) uint8, lightly compressed; one channel where all three are equal."""
    if (image == image[..., :1]).all():
        image = image[..., 0]
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


def from_png(png):
    """(h, w, 3) uint8 of PNG bytes."""
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
