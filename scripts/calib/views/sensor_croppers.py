"""Read the frames of one sensor and cut out the part around a target.

A kind of sensor is one class that satisfies the protocol Cropper. To add a kind: write its class
and add it to CROPPERS.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
import pyarrow as pa

from calib.io.status import MessageError
from calib.io.table_schemas import CAMERA_VIEWS_SCHEMA, LIDAR_VIEWS_SCHEMA
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.camera.images.image_messages import encode_png, read_bgr
from calib.sensors.lidar.clouds import cloud_messages
from calib.sensors.lidar.clouds.cloud_layout import CloudLayout
from calib.sensors.lidar.clouds.cloud_messages import LidarPoints
from calib.sensors.lidar.lidar_model import LidarModel
from calib.sensors.sensor_models import camera_from_config
from calib.targets.target_shapes import TargetShape
from calib.views.crop_windows import find_image_region, is_in_view_cone
from calib.views.field_of_view import (
    VisibilityCheck,
    check_camera_visibility,
    check_lidar_visibility,
)
from calib.views.placement_selection import WRONG_IMAGE_SIZE

Payload = dict[str, Any]
FrameReader = Callable[[int], Any]


@dataclass(frozen=True)
class TargetWindow:
    """What to cut out of one frame.

    T_sensor_target: (4, 4), wrong by up to margin (6,), m and rad. time_ns: stamp of the frame on
    the clock of the MCS. span_ns: start and end of the time in which the target stands still.
    """

    target: TargetShape
    T_sensor_target: np.ndarray
    margin: np.ndarray
    time_ns: int
    span_ns: tuple[float, float] = (-np.inf, np.inf)


class WindowCut(NamedTuple):
    """The payload columns of a view, and why it is empty, or ""."""

    payload: Payload
    reason: str = ""


class Cropper(Protocol):
    """How the stage crop handles one kind of sensor.

    has_measurement_time: False if the points of a scan have no time of their own.
    """

    schema: ClassVar[pa.Schema]
    check_visibility: ClassVar[VisibilityCheck]
    model: Any
    has_measurement_time: bool

    def __init__(self, config: dict[str, Any]) -> None: ...

    def empty_payload(self) -> Payload:
        """Return the payload columns of a view that is not kept."""

    def read_message(self, message: Any, /) -> Any:
        """Return the measurement in a message. Raises MessageError if it cannot be read."""

    def cut_window(self, measurement: Any, window: TargetWindow, /) -> WindowCut:
        """Cut the part around the target out of what read_message returned."""


class LidarCropper:
    """Cuts all returns in the angular window around a target, at any range."""

    schema: ClassVar[pa.Schema] = LIDAR_VIEWS_SCHEMA
    check_visibility: ClassVar[VisibilityCheck] = staticmethod(check_lidar_visibility)

    def __init__(self, config: dict[str, Any]) -> None:
        self.model = LidarModel.from_config(config)
        self.layout = CloudLayout.from_dict(config["layout"])
        self.has_measurement_time = self.layout.point_time is not None

    def empty_payload(self) -> Payload:
        return {"xyz": [], "ring": [], "point_time_ns": [], "intensity": []}

    def read_message(self, message: Any) -> LidarPoints:
        """Return all returns."""
        return cloud_messages.read_points(message, self.layout)

    def cut_window(self, points: LidarPoints, window: TargetWindow) -> WindowCut:
        xyz, ring, point_time_ns, intensity = points
        if not len(xyz):
            return WindowCut(self.empty_payload(), "no return at all")
        # The whole scan must lie within the span: the time span of the window alone would depend
        # on the initial guess.
        first, last = self.layout.time_span_ns(point_time_ns)
        if window.time_ns + first < window.span_ns[0] or window.time_ns + last > window.span_ns[1]:
            return WindowCut(self.empty_payload(), "scan reaches into a move")
        is_inside = is_in_view_cone(
            xyz.astype(float), window.target, window.T_sensor_target, window.margin
        )
        if not is_inside.any():
            return WindowCut(self.empty_payload(), "no return in the window")
        return WindowCut(
            {
                "xyz": xyz[is_inside].reshape(-1),
                "ring": ring[is_inside],
                "point_time_ns": point_time_ns[is_inside],
                "intensity": intensity[is_inside],
            }
        )


def image_size_reason(camera: CameraModel, image_size_px: Sequence[int]) -> str:
    """Return why images of a size, px, are not read with a lens, "" if they are."""
    if tuple(image_size_px) == camera.size_px:
        return ""
    found, expected = (f"{width} x {height}" for width, height in (image_size_px, camera.size_px))
    return f"{WRONG_IMAGE_SIZE}{found} px, expected {expected} px (size_px)"


class CameraCropper:
    """Cuts the image region around a target, as PNG."""

    schema: ClassVar[pa.Schema] = CAMERA_VIEWS_SCHEMA
    check_visibility: ClassVar[VisibilityCheck] = staticmethod(check_camera_visibility)

    def __init__(self, config: dict[str, Any]) -> None:
        self.model = camera_from_config(config)
        self.has_measurement_time = True

    def empty_payload(self) -> Payload:
        return {"u0": 0, "v0": 0, "png": b""}

    def read_message(self, message: Any) -> np.ndarray:
        """Return the image (h, w, 3) uint8, BGR."""
        return read_bgr(message)

    def cut_window(self, image: np.ndarray, window: TargetWindow) -> WindowCut:
        if reason := image_size_reason(self.model, image.shape[1::-1]):
            return WindowCut(self.empty_payload(), reason)
        u0, u1, v0, v1 = find_image_region(
            self.model, window.target, window.T_sensor_target, window.margin
        )
        return WindowCut({"u0": u0, "v0": v0, "png": encode_png(image[v0:v1, u0:u1])})


CROPPERS: dict[str, type[Cropper]] = {"lidar": LidarCropper, "camera": CameraCropper}


def make_cropper(config: dict[str, Any]) -> Cropper:
    """Return the cropper of a sensor block that is completed by the log (with_log_metadata)."""
    return CROPPERS[config["kind"]](config)


def make_frame_reader(
    log: Any, config: dict[str, Any], frames: dict[str, np.ndarray]
) -> FrameReader:
    """Return the function of a row of frames that reads what the sensor measured: points or image.

    log: the open log. config: the sensor block, completed by the log (with_log_metadata). frames:
    columns of frames.parquet of this sensor. The function raises MessageError if the message
    cannot be read.
    """
    cropper = make_cropper(config)

    def read_frame(i: int) -> Any:
        message = log.read_message_content(
            config["topic"],
            file_index=int(frames["file_index"][i]),
            log_time_ns=int(frames["log_time_ns"][i]),
            index_at_log_time=int(frames["index_at_log_time"][i]),
        )
        return cropper.read_message(message)

    return read_frame


def read_and_cut_frame(
    cropper: Cropper, read_frame: FrameReader, i: int, window: TargetWindow
) -> WindowCut:
    """Cut the window around a target out of frame i; empty if the message cannot be read."""
    try:
        return cropper.cut_window(read_frame(i), window)
    except MessageError as error:
        return WindowCut(cropper.empty_payload(), f"cannot be read: {error}")
