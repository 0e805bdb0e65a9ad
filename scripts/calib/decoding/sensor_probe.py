"""Probes: what the first messages of a sensor show of its driver, for the audit of a log.

To add a kind of sensor: write a class that follows SensorProbe, and add it to PROBE_BY_KIND.
"""

from collections import Counter
from typing import Any, Protocol

import numpy as np

from calib.io.logs.log_message import LogMessage, TopicInfo
from calib.io.safe_names import plain_text
from calib.io.status import OK, InputError, Status, failure_status
from calib.sensors.camera import camera_info_reader
from calib.sensors.camera.camera_info_reader import (
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
from calib.sensors.lidar.clouds.point_time_inference import CloudSample

N_LAYOUT_SAMPLES = 10  # clouds that a layout is inferred from
N_IMAGE_SAMPLES = 3  # images that the size is taken from, by majority
MAX_PROBED_MESSAGES = 50  # messages that are tried until enough are readable


class SensorProbe(Protocol):
    """Looks at the first messages of one sensor.

    message_types: types that are read; refused_types: {pattern of a type: what to do about it}.
    """

    message_types: tuple[str, ...]
    refused_types: dict[str, str]

    def __init__(self, config: dict[str, Any]) -> None: ...

    def add_message(self, message: LogMessage) -> None:
        """Look at a message of the sensor's topic."""

    def add_camera_info(self, message: Any) -> None:
        """Look at a CameraInfo."""

    def audit(
        self, period_ns: float, topics: dict[str, TopicInfo]
    ) -> tuple[dict[str, Any], Status]:
        """Return the sensor's block of log.json and a status.

        period_ns: median time between messages; topics: of the log.
        """


class LidarProbe:
    """Keeps a few clouds of one lidar, to infer their layout."""

    message_types, refused_types = tuple(CLOUD_TYPES), UNSUPPORTED_CLOUD_TYPES

    def __init__(self, config: dict[str, Any]) -> None:
        self.config, self.n_tried, self.first_error = config, 0, ""
        self.samples: list[CloudSample] = []

    def add_message(self, message: LogMessage) -> None:
        """Look at a message of the sensor's topic."""
        if len(self.samples) == N_LAYOUT_SAMPLES or self.n_tried == MAX_PROBED_MESSAGES:
            return
        self.n_tried += 1
        try:
            cloud = read_raw_cloud(message.content)
        except InputError as error:
            self.first_error = self.first_error or str(error)
            return
        if len(cloud.grid_index[0]):
            self.samples.append(CloudSample(cloud, message.log_time_ns))

    def add_camera_info(self, message: Any) -> None:
        """Ignore the message: a lidar has no CameraInfo."""

    def audit(
        self, period_ns: float, topics: dict[str, TopicInfo]
    ) -> tuple[dict[str, Any], Status]:
        """Return the layout of the clouds for log.json, and a status."""
        if not self.samples:
            return {}, _unreadable_status(
                "clouds", self.n_tried, self.first_error or "no return in any cloud"
            )
        samples = sorted(_keep_common_layout(self.samples), key=lambda s: s[0].stamp_ns)
        layout, inferred, status = infer_cloud_layout(
            samples, period_ns, self.config.get("point_time", {})
        )
        return {"layout": layout.to_dict(), "inferred": inferred}, status


class CameraProbe:
    """Looks at a few images of a camera, and at its CameraInfo."""

    message_types, refused_types = tuple(IMAGE_TYPES), UNSUPPORTED_IMAGE_TYPES

    def __init__(self, config: dict[str, Any]) -> None:
        self.config, self.n_tried, self.first_error = config, 0, ""
        self.sizes_px: list[tuple[int, int]] = []
        self.encoding = ""
        self.camera_infos: list[Any] = []

    def add_message(self, message: LogMessage) -> None:
        """Look at a message of the sensor's topic."""
        if len(self.sizes_px) == N_IMAGE_SAMPLES or self.n_tried == MAX_PROBED_MESSAGES:
            return
        self.n_tried += 1
        try:
            image = message.content
            self.encoding = plain_text(
                getattr(image, "encoding", "") or getattr(image, "format", "")
            )
            height, width = read_bgr(image).shape[:2]
            self.sizes_px.append((width, height))
        except InputError as error:
            self.first_error = self.first_error or str(error)

    @property
    def size_px(self) -> list[int] | None:
        """Width and height of most images; None if none was readable."""
        counts = Counter(self.sizes_px).most_common(1)
        return list(counts[0][0]) if counts else None

    def add_camera_info(self, message: Any) -> None:
        """Keep the first CameraInfo, and the first that differs from it."""
        if not self.camera_infos or (
            len(self.camera_infos) == 1 and _is_other_camera_info(self.camera_infos[0], message)
        ):
            self.camera_infos.append(message)

    def audit(
        self, period_ns: float, topics: dict[str, TopicInfo]
    ) -> tuple[dict[str, Any], Status]:
        """Return the lens and what was inferred for log.json, and a status."""
        if self.size_px is None:
            return {}, _unreadable_status("images", self.n_tried, self.first_error)
        inferred = {"image": f"{self.encoding}, {self.size_px[0]} x {self.size_px[1]} px"}
        if "camera_info" not in self.config:
            return {"inferred": inferred, "image_size_px": self.size_px}, OK
        try:
            camera, inferred["lens"] = self._camera_block(topics)
        except CameraInfoError as error:
            return {"inferred": inferred}, error.status
        status = OK
        if camera["size_px"] != self.size_px:
            status = self._size_mismatch_status(self.size_px, camera["size_px"])
        return {"camera": camera, "inferred": inferred}, status

    def _camera_block(self, topics: dict[str, TopicInfo]) -> tuple[dict[str, Any], str]:
        """Return the camera block by the CameraInfo and its source; raises CameraInfoError."""
        config = self.config
        if not self.camera_infos:
            raise _missing_camera_info(config["camera_info"], topics)
        if len(self.camera_infos) > 1:
            raise CameraInfoError(
                f"{config['camera_info']} changes within the log",
                " and ".join(map(describe_camera_info, self.camera_infos)),
                "one CameraInfo",
                "Limit the session by from_s and to_s, or set model, size_px and params.",
            )
        rectified = config.get("rectified", is_rectified_topic(config["topic"]))
        camera, source = camera_block_from_info(self.camera_infos[0], rectified)
        for key in ("model", "size_px"):
            if config.get(key, camera[key]) != camera[key]:
                raise CameraInfoError(
                    f"CameraInfo has another {key} than the rig",
                    camera[key],
                    config[key],
                    f"Remove {key} from the rig, or set params as well and remove camera_info.",
                )
        return camera, source

    def _size_mismatch_status(self, image_size_px: list[int], info_size_px: list[int]) -> Status:
        return failure_status(
            f"images and {self.config['camera_info']} differ in size",
            f"images of {image_size_px[0]} x {image_size_px[1]} px",
            f"{info_size_px[0]} x {info_size_px[1]} px, as in the CameraInfo",
            "Set camera_info to the topic published with these images, or set size_px and params "
            "for their size.",
        )


PROBE_BY_KIND: dict[str, type[SensorProbe]] = {"lidar": LidarProbe, "camera": CameraProbe}


def _keep_common_layout(samples: list[CloudSample]) -> list[CloudSample]:
    """Return the samples with the most common fields, so that damaged clouds do not count."""
    layouts = [{n: v.dtype.str for n, v in cloud.fields.items()} for cloud, _ in samples]
    common = max(layouts, key=layouts.count)
    return [s for s, layout in zip(samples, layouts, strict=True) if layout == common]


def _is_other_camera_info(one: Any, other: Any) -> bool:
    return not np.array_equal(flatten_camera_info(one), flatten_camera_info(other), equal_nan=True)


def _missing_camera_info(topic: str, topics: dict[str, TopicInfo]) -> CameraInfoError:
    found = sorted(
        k for k, (kind, _) in topics.items() if kind == camera_info_reader.CAMERA_INFO_TYPE
    )
    return CameraInfoError(
        f"no CameraInfo on {topic}",
        f"CameraInfo on {', '.join(found) or 'no topic'}",
        topic,
        "Correct camera_info, or set model, size_px and params.",
    )


def _unreadable_status(payload_kind: str, n_tried: int, first_error: str) -> Status:
    return failure_status(
        f"{payload_kind} that cannot be read",
        first_error,
        f"1 or more readable among the first {n_tried}",
        "Check the topic with `ros2 topic echo` or Foxglove, and record it again.",
    )
