"""Faults of cameras."""

import cv2
import numpy as np

import containers
import fault
from fault import IMAGES, INFO, Fault
from simulation import ros_log

COMPRESSED = IMAGES + "/compressed"


def pixels(message):
    """(h, w) of a mono8 Image."""
    return np.asarray(message.data, np.uint8).reshape(message.height, message.width)


def put(message, image, encoding="mono8"):
    """Put (h, w[, channels]) uint8 into an Image."""
    message.height, message.width = image.shape[:2]
    message.step, message.encoding = image[0].nbytes, encoding
    message.data = np.ascontiguousarray(image).reshape(-1)


def images(change, which=lambda number: True):
    """A damage that puts change(pixels) in place of images with those numbers."""

    def of_message(message, number):
        if which(number):
            put(message, change(pixels(message)))

    return fault.on(IMAGES, of_message)


def every(n):
    return lambda number: number % n == 1


def labelled(name):
    return fault.on(IMAGES, lambda m, i: setattr(m, "encoding", name))


def compressed(suffix, damage=lambda data, number: data):
    """A damage that sends files of images, each as damage(bytes, number) leaves it."""

    def of_rows(rows):
        out, number = [], 0
        for t, topic, kind, message in rows:
            if topic == IMAGES:
                data = damage(cv2.imencode(suffix, pixels(message))[1].tobytes(), number)
                fields = {"format": f"mono8; {suffix[1:]} compressed mono8", "data": data}
                fields["data"] = np.frombuffer(fields["data"], np.uint8)
                message = containers.make(ros_log.COMPRESSED, header=message.header, **fields)
                topic, kind, number = COMPRESSED, ros_log.COMPRESSED, number + 1
            out.append((t, topic, kind, message))
        return out

    return of_rows


def cut(data, number):
    return data[: len(data) // 3] if number % 4 == 1 else data


def on_compressed(session, rig, targets):
    rig["sensors"]["camera"]["topic"] = COMPRESSED


def video(rows):
    kind = "foxglove_msgs/msg/CompressedVideo"
    out = []
    for t, topic, known, message in rows:
        if topic == IMAGES:
            stamp, data = message.header.stamp, np.zeros(100, np.uint8)
            message = containers.make(
                kind, timestamp=stamp, frame_id="camera", data=data, format="h264"
            )
            known = kind
        out.append((t, topic, known, message))
    return out


def by_info(session, rig, targets):
    """The lens is taken from CameraInfo."""
    camera = rig["sensors"]["camera"]
    for key in ("model", "size_px", "params"):
        del camera[key]
    camera["camera_info"] = INFO


def infos(change):
    return fault.on(INFO, change)


def zoomed_in_half(message, number):
    if number > 17:
        message.k = message.k * [1.1, 1, 1, 1, 1.1, 1, 1, 1, 1]


def halved(image):
    return cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def blurred(image):
    """Moved by 25 px while the shutter was open."""
    return cv2.blur(image, (25, 1))


def longer_focus(session, rig, targets):
    rig["sensors"]["camera"]["params"][:2] = [810.3, 809.1]


CAMERA = {
    "blurred": Fault(
        "every third image is smeared over 25 px", "camera", images(blurred, every(3)),
    ),
    "black": Fault("every third image is black", "camera", images(lambda p: 0 * p, every(3))),
    "dropped": Fault(
        "two images of three are missing", "camera",
        fault.without(lambda row, i: row[1] in (IMAGES, INFO) and i % 3 > 0),
    ),
    "another_resolution": Fault(
        "images have half the size from the middle of the log on", "size_px says otherwise",
        images(halved, lambda number: number > 17),
    ),
    "jpeg_cut": Fault(
        "every fourth JPEG is cut short", "that is cut short", compressed(".jpg", cut),
        config=on_compressed,
    ),
    "label_bgr8": Fault("grey images labelled bgr8", "the message is damaged", labelled("bgr8")),
    "video": Fault("H.264 in place of images", "carries another type", video),
    "info_changes": Fault(
        "CameraInfo changes within the log", "changes within the log", infos(zoomed_in_half),
        config=by_info,
    ),
    "focal_wrong": Fault("a focal length that is 1 % wrong", "focal", config=longer_focus),
}  # fmt: skip
