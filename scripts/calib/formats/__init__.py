"""Files that robots load.

A format is one module with FILE, the name of what it writes, and render(calibration, parent), its
text. To add a format: write calib/formats/<name>.py, add it to FORMATS and its file to rule export.
"""

from calib.formats import ros2_static_transforms

FORMATS = {"ros2_static_transforms": ros2_static_transforms}
