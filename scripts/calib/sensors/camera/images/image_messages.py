"""The registry of image message types: images as arrays, and regions of them as lossless bytes.

To add a type: write calib/sensors/camera/images/<name>.py with the function of ImageReader, and add
one line to IMAGE_TYPES. To add an encoding: one line in pixel_encodings.PIXEL_ENCODINGS.
"""

from typing import Any, Protocol

import cv2
import numpy as np

from calib.io.status import guard_message_fields
from calib.sensors.camera.images import compressed_image, raw_image


class ImageReader(Protocol):
    """A message type, as one module."""

    def read(self, message: Any) -> np.ndarray:
        """Return the image (h, w, 3) uint8, blue green red, of a message of the log.

        Raises MessageError if it cannot be read.
        """


IMAGE_TYPES: dict[str, ImageReader] = {
    "sensor_msgs/msg/Image": raw_image,
    "sensor_msgs/msg/CompressedImage": compressed_image,
    "foxglove_msgs/msg/RawImage": raw_image,
    "foxglove_msgs/msg/CompressedImage": compressed_image,
}

_VIDEO_REMEDY = (
    "A video's frames cannot be read alone. Republish it as images (`ros2 run image_transport "
    "republish`), record those, and name their topic."
)
_PROTOBUF_IMAGE_REMEDY = (
    "Write it as {0} in ROS encoding (CDR), or record the driver's own ROS topic."
)
# Remedy by type name (fnmatch pattern) of known types that are not supported.
UNSUPPORTED_IMAGE_TYPES: dict[str, str] = {
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": _VIDEO_REMEDY,
    "foxglove_msgs/msg/CompressedVideo": _VIDEO_REMEDY,
    "foxglove.CompressedVideo*": _VIDEO_REMEDY,
    "h264_msgs/msg/Packet": _VIDEO_REMEDY,
    "theora_image_transport/msg/Packet": _VIDEO_REMEDY,
    "stereo_msgs/msg/DisparityImage": "Name the topic of an image, not of disparities.",
    "foxglove.*": _PROTOBUF_IMAGE_REMEDY.format("foxglove_msgs/msg/CompressedImage"),
}


def read_bgr(message: Any) -> np.ndarray:
    """Return the image (h, w, 3) uint8 of a message; raises MessageError if it cannot be read."""
    with guard_message_fields(message.__msgtype__):
        return IMAGE_TYPES[message.__msgtype__].read(message)


def to_grey(image: np.ndarray) -> np.ndarray:
    """Return the grey levels (h, w) uint8 of a BGR image (h, w, 3) uint8."""
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def encode_png(image: np.ndarray) -> bytes:
    """Return PNG bytes of an image (h, w, 3) uint8; one channel if all three are equal."""
    if (image == image[..., :1]).all():
        image = image[..., 0]
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


def decode_png(png: bytes) -> np.ndarray:
    """Return the image (h, w, 3) uint8 of PNG bytes."""
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError("not a PNG file")
    return image
