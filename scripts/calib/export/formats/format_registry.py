"""Files that robots load.

A format is one module with
  TITLE       what its files are, and who loads them;
  CONVENTION  which way its transforms go, in one line, for the index and the files;
  render(scene)   {file name: text, bytes, or the Status of what it cannot hold}.
Every file holds its convention and one worked point. What a format cannot say, such as a camera
model that it has no name for, is a Status with the reason, and nothing is written in its place.

To add a format: write calib/export/formats/<name>.py and add it to FORMATS; tests/test_formats.py
then
asks for a reader of it.
"""

from calib.export.formats import (
    autoware,
    foxglove,
    kalibr,
    koide3,
    mrcal,
    opencv,
    ros2_launch,
    ros2_static_transforms,
    ros_camera_info,
    tf_static,
    urdf,
    xacro,
)

FORMATS = {
    "ros2_static_transforms": ros2_static_transforms,
    "ros2_launch": ros2_launch,
    "urdf": urdf,
    "xacro": xacro,
    "tf_static": tf_static,
    "ros_camera_info": ros_camera_info,
    "opencv": opencv,
    "kalibr": kalibr,
    "mrcal": mrcal,
    "koide3": koide3,
    "autoware": autoware,
    "foxglove": foxglove,
}
