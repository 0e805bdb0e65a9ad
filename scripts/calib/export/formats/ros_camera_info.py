"""Intrinsics of each camera as camera_info_manager reads them (camera_calibration_parsers)."""

import yaml

from calib.export.calibrated_scene import (
    format_hash_comment,
    format_worked_pixel,
    format_worked_point,
)
from calib.io.status import failure_status

TITLE = "intrinsics for camera_info_manager (camera_info_url: file://…)"
CONVENTION = "pixel (0, 0) is the centre of the first pixel; x right, y down, z forward; raw images"
ROS_DISTORTION_MODELS = {
    "radtan": ("plumb_bob", 5),
    "kannala_brandt": ("equidistant", 4),
}  # name, numbers


def render_files(scene):
    """camera_info_<camera>.yaml of every camera."""
    return {
        f"camera_info_{n}.yaml": _render_camera_info(scene, s) for n, s in scene.cameras.items()
    }


def _render_camera_info(scene, sensor):
    if sensor.camera is None:
        return failure_status(f"the parameters of {sensor.name} are not in its configuration")
    if sensor.camera.model not in ROS_DISTORTION_MODELS:
        return failure_status(f"sensor_msgs/CameraInfo has no name for {sensor.camera.model}")
    head = [f"Camera {sensor.name} of rig {scene.rig}: {CONVENTION}.", format_worked_pixel(sensor)]
    head.append(format_worked_point(sensor.frame, scene.parent_frame, sensor.T_parent_sensor))
    return format_hash_comment(head) + yaml.safe_dump(
        camera_info_json(sensor), sort_keys=False, width=1000
    )


def camera_info_json(sensor):
    """What the file holds, by key."""
    name, count = ROS_DISTORTION_MODELS[sensor.camera.model]
    fx, fy, cx, cy, *distortion = sensor.camera.params
    K = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    P = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    eye = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    return {
        "image_width": sensor.camera.size_px[0],
        "image_height": sensor.camera.size_px[1],
        "camera_name": sensor.name,
        "camera_matrix": {"rows": 3, "cols": 3, "data": K},
        "distortion_model": name,
        "distortion_coefficients": {"rows": 1, "cols": count, "data": distortion[:count]},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": eye},
        "projection_matrix": {"rows": 3, "cols": 4, "data": P},
    }
