"""Faults of cameras."""

import cv2
import numpy as np

from calib.io.logs.ros_messages import COMPRESSED_IMAGE_TYPE
from helpers.fault_catalog.fault_case import (
    CAMERA_INFO_TOPIC,
    IMAGE_TOPIC,
    FaultCase,
    damage_topic,
    drop_rows,
)
from helpers.log_containers import make_ros2_message

COMPRESSED_TOPIC = IMAGE_TOPIC + "/compressed"


def read_mono_pixels(message):
    """(h, w) of a mono8 Image."""
    return np.asarray(message.data, np.uint8).reshape(message.height, message.width)


def set_image_pixels(message, image, encoding="mono8"):
    """Put (h, w[, channels]) uint8 into an Image."""
    message.height, message.width = image.shape[:2]
    message.step, message.encoding = image[0].nbytes, encoding
    message.data = np.ascontiguousarray(image).reshape(-1)


def damage_images(change_pixels, is_affected=lambda number: True):
    """A damage that puts change(pixels) in place of images with those numbers."""

    def of_message(message, number):
        if is_affected(number):
            set_image_pixels(message, change_pixels(read_mono_pixels(message)))

    return damage_topic(IMAGE_TOPIC, of_message)


def select_every_nth(n):
    return lambda number: number % n == 1


def set_encoding_label(name):
    return damage_topic(IMAGE_TOPIC, lambda m, i: setattr(m, "encoding", name))


def send_compressed_images(suffix, damage_bytes=lambda data, number: data):
    """A damage that sends files of images, each as damage(bytes, number) leaves it."""

    def of_rows(rows):
        out, number = [], 0
        for t, topic, kind, message in rows:
            if topic == IMAGE_TOPIC:
                data = damage_bytes(
                    cv2.imencode(suffix, read_mono_pixels(message))[1].tobytes(), number
                )
                fields = {"format": f"mono8; {suffix[1:]} compressed mono8", "data": data}
                fields["data"] = np.frombuffer(fields["data"], np.uint8)
                message = make_ros2_message(COMPRESSED_IMAGE_TYPE, header=message.header, **fields)
                topic, kind, number = COMPRESSED_TOPIC, COMPRESSED_IMAGE_TYPE, number + 1
            out.append((t, topic, kind, message))
        return out

    return of_rows


def truncate_every_fourth(data, number):
    return data[: len(data) // 3] if number % 4 == 1 else data


def use_compressed_topic(session, rig, targets):
    rig["sensors"]["camera"]["topic"] = COMPRESSED_TOPIC


def send_video(rows):
    kind = "foxglove_msgs/msg/CompressedVideo"
    out = []
    for t, topic, known, message in rows:
        if topic == IMAGE_TOPIC:
            stamp, data = message.header.stamp, np.zeros(100, np.uint8)
            message = make_ros2_message(
                kind, timestamp=stamp, frame_id="camera", data=data, format="h264"
            )
            known = kind
        out.append((t, topic, known, message))
    return out


def use_camera_info(session, rig, targets):
    """The lens is taken from CameraInfo."""
    camera = rig["sensors"]["camera"]
    for key in ("model", "size_px", "params"):
        del camera[key]
    camera["camera_info"] = CAMERA_INFO_TOPIC


def damage_camera_info(change_message):
    return damage_topic(CAMERA_INFO_TOPIC, change_message)


def zoom_second_half(message, number):
    if number > 17:
        message.k = message.k * [1.1, 1, 1, 1, 1.1, 1, 1, 1, 1]


def halve_image(image):
    return cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def smear_image(image):
    """Moved by 25 px while the shutter was open."""
    return cv2.blur(image, (25, 1))


def lengthen_focal_length(session, rig, targets):
    rig["sensors"]["camera"]["params"][:2] = [810.3, 809.1]


CAMERA_FAULTS = {
    "blurred": FaultCase(
        "every third image is smeared over 25 px",
        "camera",
        damage_images(smear_image, select_every_nth(3)),
    ),
    "black": FaultCase(
        "every third image is black", "camera", damage_images(lambda p: 0 * p, select_every_nth(3))
    ),
    "dropped": FaultCase(
        "two images of three are missing",
        "camera",
        drop_rows(lambda row, i: row[1] in (IMAGE_TOPIC, CAMERA_INFO_TOPIC) and i % 3 > 0),
    ),
    "another_resolution": FaultCase(
        "images have half the size from the middle of the log on",
        "px (size_px)",
        damage_images(halve_image, lambda number: number > 17),
    ),
    "jpeg_cut": FaultCase(
        "every fourth JPEG is cut short",
        "that is cut short",
        send_compressed_images(".jpg", truncate_every_fourth),
        change_config=use_compressed_topic,
    ),
    "label_bgr8": FaultCase(
        "grey images labelled bgr8", "the message is damaged", set_encoding_label("bgr8")
    ),
    "video": FaultCase("H.264 in place of images", "carries another type", send_video),
    "info_changes": FaultCase(
        "CameraInfo changes within the log",
        "changes within the log",
        damage_camera_info(zoom_second_half),
        change_config=use_camera_info,
    ),
    "focal_wrong": FaultCase(
        "a focal length that is 1 % wrong", "focal", change_config=lengthen_focal_length
    ),
}
