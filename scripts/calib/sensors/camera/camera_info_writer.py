"""Build sensor_msgs/CameraInfo from a camera model: the reverse of camera_info."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.io.logs.ros_messages import make_ros_header, make_ros_message
from calib.sensors.camera.camera_info_reader import CAMERA_INFO_TYPE
from calib.sensors.camera.camera_model import CameraModel

# By camera model: the name that ROS has for its distortion, and how many coefficients that has.
ROS_DISTORTION_MODELS = {"radtan": ("plumb_bob", 5), "kannala_brandt": ("equidistant", 4)}


@dataclass(frozen=True)
class RosIntrinsics:
    """Intrinsics of raw images as ROS names them; matrices row by row, P for no rectification."""

    distortion_model: str
    D: list[float]
    K: list[float]
    R: list[float]
    P: list[float]


def find_ros_intrinsics(camera: CameraModel) -> RosIntrinsics | None:
    """Express a camera model in the terms of CameraInfo; None if ROS has no name for the model."""
    if camera.model not in ROS_DISTORTION_MODELS:
        return None
    name, n_coefficients = ROS_DISTORTION_MODELS[camera.model]
    fx, fy, cx, cy, *distortion = camera.params
    return RosIntrinsics(
        distortion_model=name,
        D=distortion[:n_coefficients],
        K=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def make_camera_info_message(stamp_ns: int, frame: str, camera: CameraModel) -> Any | None:
    """Make the CameraInfo of a camera model; None if ROS has no name for the model."""
    intrinsics = find_ros_intrinsics(camera)
    if intrinsics is None:
        return None
    whole_image = dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0)
    width, height = camera.size_px
    return make_ros_message(
        CAMERA_INFO_TYPE,
        header=make_ros_header(stamp_ns, frame),
        height=height,
        width=width,
        distortion_model=intrinsics.distortion_model,
        d=np.array(intrinsics.D),
        k=np.array(intrinsics.K),
        r=np.array(intrinsics.R),
        p=np.array(intrinsics.P),
        binning_x=0,
        binning_y=0,
        roi=make_ros_message("sensor_msgs/msg/RegionOfInterest", **whole_image, do_rectify=False),
    )
