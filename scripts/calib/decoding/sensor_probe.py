"""What the first messages of a sensor tell of how its driver publishes, for the audit of a log.

To add a kind of sensor: a class with the methods of Lidar and a line in KINDS.
"""

import numpy as np

from calib.io.status import OK, InputError, failed
from calib.sensors.camera import camera_info
from calib.sensors.camera.images import image_messages
from calib.sensors.lidar.clouds import cloud_layout, cloud_messages

SAMPLES = 10  # messages that a layout is inferred from
TRIES = 50  # messages among which they are looked for


class Lidar:
    """The clouds of one lidar, of which a few are kept until all is told."""

    types, refused = tuple(cloud_messages.TYPES), cloud_messages.REFUSED

    def __init__(self, config):
        self.config, self.samples, self.tried, self.trouble = config, [], 0, ""

    def take(self, message):
        """Look at one Message of the sensor's topic."""
        if len(self.samples) == SAMPLES or self.tried == TRIES:
            return
        self.tried += 1
        try:
            cloud = cloud_messages.read(message.content)
        except InputError as error:
            self.trouble = self.trouble or str(error)
            return
        if len(cloud.place[0]):
            self.samples.append((cloud, message.log_t))

    def take_info(self, message):
        """A lidar has no CameraInfo."""

    def told(self, period, topics):
        """(what the audit says besides, Status); period, ns, from message to message; topics of
        the log, with their types."""
        if not self.samples:
            return {}, _unread("clouds", self.tried, self.trouble or "no return in any of them")
        samples = sorted(_alike(self.samples), key=lambda s: s[0].stamp)
        layout, words, status = cloud_layout.infer(
            samples, period, self.config.get("point_time", {})
        )
        return {"layout": layout.to_dict(), "told": words}, status


class Camera:
    """The images of one camera, of which one is looked at, and its CameraInfo."""

    types, refused = tuple(image_messages.TYPES), image_messages.REFUSED

    def __init__(self, config):
        self.config, self.tried, self.trouble = config, 0, ""
        self.size, self.encoding, self.infos = None, "", []

    def take(self, message):
        """Look at one Message of the sensor's topic."""
        if self.size or self.tried == TRIES:
            return
        self.tried += 1
        try:
            image = message.content
            self.encoding = getattr(image, "encoding", "") or getattr(image, "format", "")
            self.size = list(image_messages.bgr(image).shape[1::-1])
        except InputError as error:
            self.trouble = self.trouble or str(error)

    def take_info(self, message):
        """Look at one CameraInfo: the first that differs from the first is kept as well."""
        if not self.infos or (len(self.infos) == 1 and _differ(self.infos[0], message)):
            self.infos.append(message)

    def told(self, period, topics):
        """(what the audit says besides, Status); topics of the log, with their types."""
        if self.size is None:
            return {}, _unread("images", self.tried, self.trouble)
        words = {"image": f"{self.encoding}, {self.size[0]} x {self.size[1]} px"}
        if "camera_info" not in self.config:
            return {"told": words}, OK
        try:
            camera, words["lens"] = self._camera(topics)
        except camera_info.CameraInfoError as error:
            return {"told": words}, error.status
        status = OK if camera["size_px"] == self.size else self._resized(camera["size_px"])
        return {"camera": camera, "told": words}, status

    def _camera(self, topics):
        """(camera block, in words where it comes from)."""
        config = self.config
        if not self.infos:
            raise camera_info.CameraInfoError(*_no_info(config["camera_info"], topics))
        if len(self.infos) > 1:
            raise camera_info.CameraInfoError(
                f"{config['camera_info']} changes within the log",
                " and ".join(map(camera_info.told, self.infos)),
                "one CameraInfo",
                "Bound the session by from_s and to_s, or write model, size_px and params.",
            )
        rectified = config.get("rectified", camera_info.by_name(config["topic"]))
        camera, words = camera_info.block(self.infos[0], rectified)
        for key in ("model", "size_px"):
            if config.get(key, camera[key]) != camera[key]:
                raise camera_info.CameraInfoError(
                    f"CameraInfo is of another {key} than the rig",
                    *(camera[key], config[key]),
                    f"Leave {key} out of the rig, or write params as well in place of camera_info.",
                )
        return camera, words

    def _resized(self, size):
        return failed(
            f"images and {self.config['camera_info']} differ in size",
            f"images of {self.size[0]} x {self.size[1]} px",
            f"{size[0]} x {size[1]} px, as the CameraInfo says",
            "Name the CameraInfo that is published with these images, or write size_px and params "
            "for their size.",
        )


KINDS = {"lidar": Lidar, "camera": Camera}


def _alike(samples):
    """The samples whose clouds have the fields that most have: a damaged one tells of no other."""
    laid = [{n: v.dtype.str for n, v in cloud.fields.items()} for cloud, _ in samples]
    common = max(laid, key=laid.count)
    return [s for s, fields in zip(samples, laid, strict=True) if fields == common]


def _differ(one, other):
    return not np.array_equal(camera_info.numbers(one), camera_info.numbers(other), equal_nan=True)


def _no_info(topic, topics):
    known = sorted(k for k, (kind, _) in topics.items() if kind == camera_info.TYPE)
    return (
        f"no CameraInfo on {topic}",
        f"CameraInfo on {', '.join(known) or 'no topic'}",
        topic,
        "Correct camera_info, or write model, size_px and params.",
    )


def _unread(what, tried, trouble):
    return failed(
        f"{what} that cannot be read",
        trouble,
        f"1 of the first {tried} or more",
        "Look at the topic with `ros2 topic echo` or Foxglove, and record it anew.",
    )
