"""Keypoints of one sensor: found from a guess, then again from the pose that all views agree on.

One function per kind of sensor: (job, views) -> keypoints (columns), [(view, Status)] of every kept
view, and the working pose T_robot_sensor (4, 4), or None where nothing was found.
"""

import numpy as np

from calib.extraction import camera_keypoints, lidar_keypoints
from calib.io import parquet_tables, table_schemas

SENSORS = {"camera": camera_keypoints.extract, "lidar": lidar_keypoints.extract}
ONE_VIEW = {"camera": camera_keypoints.parts_of, "lidar": lidar_keypoints.around}
NOISE = {
    "camera": camera_keypoints.NOISE,
    "lidar": lidar_keypoints.NOISE,
}  # times σ: from how far members still count


def at(kind, job, views, T_robot_sensor):
    """(keypoints, outcomes) of the kept views whose place is known, at a pose of the sensor."""
    parts, outcomes = [], []
    for i in np.flatnonzero(views["kept"]):
        if int(views["placement"][i]) in job.places:
            found, status = ONE_VIEW[kind](job, views, i, T_robot_sensor)
            parts += found
            outcomes.append((int(views["view"][i]), status))
    return parquet_tables.concatenate(parts, table_schemas.KEYPOINTS), outcomes
