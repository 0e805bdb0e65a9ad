"""Messages of cameras as arrays, and regions of them as lossless bytes.

A type of message is one module with read(message) -> (h, w, 3) uint8, blue green red. To add one:
write calib/sensors/camera/images/<name>.py and add it to TYPES. To add an encoding: one line in
`encodings`.
"""

import cv2
import numpy as np

from calib.io.status import guard_message_fields
from calib.sensors.camera.images import compressed_image, raw_image

IMAGE_TYPES = {
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
# Types that are known and not read, by pattern (fnmatch): what to do.
UNSUPPORTED_IMAGE_TYPES = {
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": _VIDEO_REMEDY,
    "foxglove_msgs/msg/CompressedVideo": _VIDEO_REMEDY,
    "foxglove.CompressedVideo*": _VIDEO_REMEDY,
    "h264_msgs/msg/Packet": _VIDEO_REMEDY,
    "theora_image_transport/msg/Packet": _VIDEO_REMEDY,
    "stereo_msgs/msg/DisparityImage": "Name the topic of an image, not of disparities.",
    "foxglove.*": _PROTOBUF_IMAGE_REMEDY.format("foxglove_msgs/msg/CompressedImage"),
}


def read_bgr(message):
    """(h, w, 3) uint8 of a message. Raises MessageError where it cannot be read."""
    with guard_message_fields(message.__msgtype__):
        return IMAGE_TYPES[message.__msgtype__].read(message)


def to_grey(image):
    """(h, w) uint8 of a (h, w, 3) uint8 image."""
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def encode_png(image):
    """PNG bytes of (h, w, 3) uint8, lightly compressed; one channel where all three are equal."""
    if (image == image[..., :1]).all():
        image = image[..., 0]
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


def decode_png(png):
    """(h, w, 3) uint8 of PNG bytes."""
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
