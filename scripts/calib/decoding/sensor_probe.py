"""What the first messages of a sensor tell of how its driver publishes, for the audit of a log.

To add a kind of sensor: a class with the methods of Lidar and a line in KINDS.
"""

import numpy as np

from calib.io.status import OK, InputError, failure_status
from calib.sensors.camera import camera_info
from calib.sensors.camera.camera_info import (
    CameraInfoError,
    camera_block_from_info,
    describe_camera_info,
    flatten_camera_info,
    is_rectified_topic,
)
from calib.sensors.camera.images.image_messages import (
    IMAGE_TYPES,
    UNSUPPORTED_IMAGE_TYPES,
    read_bgr,
)
from calib.sensors.lidar.clouds.cloud_layout import infer_cloud_layout
from calib.sensors.lidar.clouds.cloud_messages import (
    CLOUD_TYPES,
    UNSUPPORTED_CLOUD_TYPES,
    read_raw_cloud,
)

N_LAYOUT_SAMPLES = 10  # messages that a layout is inferred from
MAX_PROBED_MESSAGES = 50  # messages among which they are looked for


class LidarProbe:
    """The clouds of one lidar, of which a few are kept until all is told."""

    message_types, refused_types = tuple(CLOUD_TYPES), UNSUPPORTED_CLOUD_TYPES

    def __init__(self, config):
        self.config, self.samples, self.n_tried, self.first_error = config, [], 0, ""

    def add_message(self, message):
        """Look at one Message of the sensor's topic."""
        if len(self.samples) == N_LAYOUT_SAMPLES or self.n_tried == MAX_PROBED_MESSAGES:
            return
        self.n_tried += 1
        try:
            cloud = read_raw_cloud(message.content)
        except InputError as error:
            self.first_error = self.first_error or str(error)
            return
        if len(cloud.grid_index[0]):
            self.samples.append((cloud, message.log_time_ns))

    def add_camera_info(self, message):
        """A lidar has no CameraInfo."""

    def audit(self, period_ns, topics):
        """(what the audit says besides, Status); period, ns, from message to message; topics of
        the log, with their types."""
        if not self.samples:
            return {}, _unreadable_status(
                "clouds", self.n_tried, self.first_error or "no return in any of them"
            )
        samples = sorted(_keep_common_layout(self.samples), key=lambda s: s[0].stamp_ns)
        layout, words, status = infer_cloud_layout(
            samples, period_ns, self.config.get("point_time", {})
        )
        return {"layout": layout.to_dict(), "inferred": words}, status


class CameraProbe:
    """The images of one camera, of which one is looked at, and its CameraInfo."""

    message_types, refused_types = tuple(IMAGE_TYPES), UNSUPPORTED_IMAGE_TYPES

    def __init__(self, config):
        self.config, self.n_tried, self.first_error = config, 0, ""
        self.size_px, self.encoding, self.camera_infos = None, "", []

    def add_message(self, message):
        """Look at one Message of the sensor's topic."""
        if self.size_px or self.n_tried == MAX_PROBED_MESSAGES:
            return
        self.n_tried += 1
        try:
            image = message.content
            self.encoding = getattr(image, "encoding", "") or getattr(image, "format", "")
            self.size_px = list(read_bgr(image).shape[1::-1])
        except InputError as error:
            self.first_error = self.first_error or str(error)

    def add_camera_info(self, message):
        """Look at one CameraInfo: the first that differs from the first is kept as well."""
        if not self.camera_infos or (
            len(self.camera_infos) == 1 and _is_other_camera_info(self.camera_infos[0], message)
        ):
            self.camera_infos.append(message)

    def audit(self, period_ns, topics):
        """(what the audit says besides, Status); topics of the log, with their types."""
        if self.size_px is None:
            return {}, _unreadable_status("images", self.n_tried, self.first_error)
        words = {"image": f"{self.encoding}, {self.size_px[0]} x {self.size_px[1]} px"}
        if "camera_info" not in self.config:
            return {"inferred": words}, OK
        try:
            camera, words["lens"] = self._camera_block(topics)
        except CameraInfoError as error:
            return {"inferred": words}, error.status
        status = (
            OK
            if camera["size_px"] == self.size_px
            else self._size_mismatch_status(camera["size_px"])
        )
        return {"camera": camera, "inferred": words}, status

    def _camera_block(self, topics):
        """(camera block, in words where it comes from)."""
        config = self.config
        if not self.camera_infos:
            raise CameraInfoError(*_missing_camera_info(config["camera_info"], topics))
        if len(self.camera_infos) > 1:
            raise CameraInfoError(
                f"{config['camera_info']} changes within the log",
                " and ".join(map(describe_camera_info, self.camera_infos)),
                "one CameraInfo",
                "Bound the session by from_s and to_s, or write model, size_px and params.",
            )
        rectified = config.get("rectified", is_rectified_topic(config["topic"]))
        camera, words = camera_block_from_info(self.camera_infos[0], rectified)
        for key in ("model", "size_px"):
            if config.get(key, camera[key]) != camera[key]:
                raise CameraInfoError(
                    f"CameraInfo is of another {key} than the rig",
                    *(camera[key], config[key]),
                    f"Leave {key} out of the rig, or write params as well in place of camera_info.",
                )
        return camera, words

    def _size_mismatch_status(self, info_size_px):
        return failure_status(
            f"images and {self.config['camera_info']} differ in size",
            f"images of {self.size_px[0]} x {self.size_px[1]} px",
            f"{info_size_px[0]} x {info_size_px[1]} px, as the CameraInfo says",
            "Name the CameraInfo that is published with these images, or write size_px and params "
            "for their size.",
        )


PROBE_BY_KIND = {"lidar": LidarProbe, "camera": CameraProbe}


def _keep_common_layout(samples):
    """The samples whose clouds have the fields that most have: a damaged one tells of no other."""
    laid = [{n: v.dtype.str for n, v in cloud.fields.items()} for cloud, _ in samples]
    common = max(laid, key=laid.count)
    return [s for s, fields in zip(samples, laid, strict=True) if fields == common]


def _is_other_camera_info(one, other):
    return not np.array_equal(flatten_camera_info(one), flatten_camera_info(other), equal_nan=True)


def _missing_camera_info(topic, topics):
    known = sorted(k for k, (kind, _) in topics.items() if kind == camera_info.CAMERA_INFO_TYPE)
    return (
        f"no CameraInfo on {topic}",
        f"CameraInfo on {', '.join(known) or 'no topic'}",
        topic,
        "Correct camera_info, or write model, size_px and params.",
    )


def _unreadable_status(payload_kind, tried, first_error):
    return failure_status(
        f"{payload_kind} that cannot be read",
        first_error,
        f"1 of the first {tried} or more",
        "Look at the topic with `ros2 topic echo` or Foxglove, and record it anew.",
    )
