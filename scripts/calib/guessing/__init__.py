"""Where a sensor sits, from what it saw of targets whose poses in the robot frame are known.

One function per kind of sensor: (model, shapes, looks, content_of, options) -> consensus.Found.
model is its Camera or rig.Lidar; shapes are the targets by name; a look is one frame in one still
placement of a target (looks.Look); content_of(i) reads frame i; options are those of `guess`.
"""

from calib.guessing import camera, lidar

SENSORS = {"camera": camera.find, "lidar": lidar.find}
