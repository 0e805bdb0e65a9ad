"""Keypoints of one sensor: found from a guess, then again from the pose that all views agree on.

One function per kind of sensor: (job, views) -> keypoints (columns), [(view, Status)] of every kept
view, and the working pose T_robot_sensor (4, 4), or None where nothing was found.
"""

import numpy as np

from calib.extraction.camera_keypoints import (
    CAMERA_NOISE_FACTOR,
    extract_camera_keypoints,
    list_camera_view_parts,
)
from calib.extraction.lidar_keypoints import (
    LIDAR_NOISE_FACTOR,
    extract_lidar_keypoints,
    extract_lidar_view,
)
from calib.io.parquet_tables import concatenate_columns
from calib.io.table_schemas import KEYPOINTS_SCHEMA

KEYPOINT_EXTRACTORS = {"camera": extract_camera_keypoints, "lidar": extract_lidar_keypoints}
VIEW_EXTRACTORS = {"camera": list_camera_view_parts, "lidar": extract_lidar_view}
NOISE_FACTORS = {
    "camera": CAMERA_NOISE_FACTOR,
    "lidar": LIDAR_NOISE_FACTOR,
}  # times σ: from how far members still count


def extract_views_at_pose(kind, context, views, T_robot_sensor):
    """(keypoints, outcomes) of the kept views whose place is known, at a pose of the sensor."""
    parts, outcomes = [], []
    for i in np.flatnonzero(views["kept"]):
        if int(views["placement"][i]) in context.placements:
            found, status = VIEW_EXTRACTORS[kind](context, views, i, T_robot_sensor)
            parts += found
            outcomes.append((int(views["view"][i]), status))
    return concatenate_columns(parts, KEYPOINTS_SCHEMA), outcomes
