"""Intrinsics of each camera as camera_info_manager reads them (camera_calibration_parsers)."""

import yaml

from calib.export.calibrated_scene import comment, worked_pixel, worked_point
from calib.io.status import failed

TITLE = "intrinsics for camera_info_manager (camera_info_url: file://…)"
CONVENTION = "pixel (0, 0) is the centre of the first pixel; x right, y down, z forward; raw images"
MODELS = {"radtan": ("plumb_bob", 5), "kannala_brandt": ("equidistant", 4)}  # name, numbers


def render(scene):
    """camera_info_<camera>.yaml of every camera."""
    return {f"camera_info_{n}.yaml": _file(scene, s) for n, s in scene.cameras.items()}


def _file(scene, sensor):
    if sensor.camera is None:
        return failed(f"the parameters of {sensor.name} are not in its configuration")
    if sensor.camera.model not in MODELS:
        return failed(f"sensor_msgs/CameraInfo has no name for {sensor.camera.model}")
    head = [f"Camera {sensor.name} of rig {scene.rig}: {CONVENTION}.", worked_pixel(sensor)]
    head.append(worked_point(sensor.frame, scene.parent, sensor.T))
    return comment(head) + yaml.safe_dump(content(sensor), sort_keys=False, width=1000)


def content(sensor):
    """What the file holds, by key."""
    name, count = MODELS[sensor.camera.model]
    fx, fy, cx, cy, *distortion = sensor.camera.params
    K = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    P = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    eye = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    return {
        "image_width": sensor.camera.size[0],
        "image_height": sensor.camera.size[1],
        "camera_name": sensor.name,
        "camera_matrix": {"rows": 3, "cols": 3, "data": K},
        "distortion_model": name,
        "distortion_coefficients": {"rows": 1, "cols": count, "data": distortion[:count]},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": eye},
        "projection_matrix": {"rows": 3, "cols": 4, "data": P},
    }
