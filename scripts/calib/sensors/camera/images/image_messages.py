"""Messages of cameras as arrays, and regions of them as lossless bytes.

A type of message is one module with read(message) -> (h, w, 3) uint8, blue green red. To add one:
write calib/sensors/camera/images/<name>.py and add it to TYPES. To add an encoding: one line in
`encodings`.
"""

import cv2
import numpy as np

from calib.io.status import as_defined
from calib.sensors.camera.images import compressed_image, raw_image

TYPES = {
    "sensor_msgs/msg/Image": raw_image,
    "sensor_msgs/msg/CompressedImage": compressed_image,
    "foxglove_msgs/msg/RawImage": raw_image,
    "foxglove_msgs/msg/CompressedImage": compressed_image,
}

_VIDEO = (
    "A video's frames cannot be read alone. Republish it as images (`ros2 run image_transport "
    "republish`), record those, and name their topic."
)
_PROTOBUF = "Write it as {0} in ROS encoding (CDR), or record the driver's own ROS topic."
# Types that are known and not read, by pattern (fnmatch): what to do.
REFUSED = {
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": _VIDEO,
    "foxglove_msgs/msg/CompressedVideo": _VIDEO,
    "foxglove.CompressedVideo*": _VIDEO,
    "h264_msgs/msg/Packet": _VIDEO,
    "theora_image_transport/msg/Packet": _VIDEO,
    "stereo_msgs/msg/DisparityImage": "Name the topic of an image, not of disparities.",
    "foxglove.*": _PROTOBUF.format("foxglove_msgs/msg/CompressedImage"),
}


def bgr(message):
    """(h, w, 3) uint8 of a message. Raises MessageError where it cannot be read."""
    with as_defined(message.__msgtype__):
        return TYPES[message.__msgtype__].read(message)


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
