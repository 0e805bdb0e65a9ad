"""What the config states of one sensor, its targets and the motion capture; and a correction."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from calib.io.config_change import ConfigChange
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.target_shapes import TargetShape


@dataclass(frozen=True)
class StatedSetup:
    """What one sensor's detections are compared with.

    mounts: T_body_target (4, 4) by target, of those that have one; T_robot_body: (4, 4) by
    placement; T_robot_sensor: (4, 4), None if nothing states it, with its σ (6,), m and rad;
    other_quaternions: T_robot_body with the quaternions of the motion capture in the other order,
    which is named other_order; images: (h, w) uint8, of a camera; is_mirrored: whether these are
    taken mirrored left to right; has_camera_info: whether a CameraInfo states the lens.
    """

    sensor: str
    model: CameraModel | LidarModel
    targets: dict[str, TargetShape]
    mounts: dict[str, np.ndarray]
    T_robot_body: dict[int, np.ndarray]
    T_robot_sensor: np.ndarray | None
    sigma: np.ndarray
    other_quaternions: dict[int, np.ndarray] = field(default_factory=dict)
    other_order: str = "wxyz"
    images: tuple[np.ndarray, ...] = ()
    is_mirrored: bool = False
    has_camera_info: bool = False

    @property
    def has_image_size(self) -> bool:
        """Whether the images, if there are any, are of the size that the lens is for."""
        if not isinstance(self.model, CameraModel) or not self.images:
            return True
        return self.model.size_px == self.images[0].shape[1::-1]


class ConfigCorrection(NamedTuple):
    """A setup without one mistake, the mistake in words, and what to write or do.

    change: of the config, if one key has to be written.
    """

    setup: StatedSetup
    reason: str
    remedy: str
    change: ConfigChange | None = None


class Mistake(Protocol):
    """A kind of mistake: yields the setups that a user who made it may have meant."""

    def __call__(self, stated: StatedSetup, /) -> Iterable[ConfigCorrection]: ...
