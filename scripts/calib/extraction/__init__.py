"""Keypoints of one sensor: found from a guess, then again from the pose that all views agree on.

One function per kind of sensor: (job, views) -> keypoints (columns), [(view, Status)] of every kept
view, and the working pose T_robot_sensor (4, 4), or None where nothing was found.
"""

from calib.extraction import camera, lidar

SENSORS = {"camera": camera.extract, "lidar": lidar.extract}
NOISE = {"camera": camera.NOISE, "lidar": lidar.NOISE}  # times σ: from how far members still count
