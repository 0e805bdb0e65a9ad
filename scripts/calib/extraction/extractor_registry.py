"""The registry of keypoint extractors by kind of sensor.

To add a kind of sensor: write its functions and add one line to SENSOR_EXTRACTORS.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calib.extraction.camera_keypoints import (
    extract_camera_keypoints,
    extract_camera_view,
)
from calib.extraction.extraction_inputs import ExtractionContext
from calib.extraction.extraction_results import Extraction, ViewKeypoints
from calib.extraction.lidar_keypoints import (
    extract_lidar_keypoints,
    extract_lidar_view,
)
from calib.views.target_placements import Columns


class KeypointExtractor(Protocol):
    """Extracts from all views of a sensor, from the initial guess to the pose they agree on."""

    def __call__(self, context: ExtractionContext, views: Columns, /) -> Extraction: ...


class ViewExtractor(Protocol):
    """Extracts from the view in row i at a pose T_robot_sensor (4, 4)."""

    def __call__(
        self, context: ExtractionContext, views: Columns, i: int, T_robot_sensor: np.ndarray, /
    ) -> ViewKeypoints: ...


@dataclass(frozen=True)
class SensorExtractor:
    """How one kind of sensor is extracted."""

    extract: KeypointExtractor
    extract_view: ViewExtractor


SENSOR_EXTRACTORS: dict[str, SensorExtractor] = {
    "camera": SensorExtractor(extract_camera_keypoints, extract_camera_view),
    "lidar": SensorExtractor(extract_lidar_keypoints, extract_lidar_view),
}
