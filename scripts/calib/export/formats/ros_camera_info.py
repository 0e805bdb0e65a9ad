"""Intrinsics of each camera as camera_info_manager reads them (camera_calibration_parsers)."""

from typing import Any

import yaml

from calib.export.calibrated_scene import (
    ExportScene,
    ExportSensor,
    format_hash_comment,
    format_worked_pixel,
    format_worked_point,
    lens_or_status,
)
from calib.io.status import Status, failure_status
from calib.sensors.camera.camera_info_writer import RosIntrinsics, find_ros_intrinsics
from calib.sensors.camera.camera_model import CameraModel

TITLE = "intrinsics for camera_info_manager (camera_info_url: file://…)"
FILE_PATTERNS: tuple[str, ...] = ("camera_info_*.yaml",)
CONVENTION = "pixel (0, 0) is the centre of the first pixel; x right, y down, z forward; raw images"


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render camera_info_<camera>.yaml of every camera."""
    return {
        f"camera_info_{n}.yaml": _render_camera_info(scene, s) for n, s in scene.cameras.items()
    }


def _render_camera_info(scene: ExportScene, sensor: ExportSensor) -> str | Status:
    camera = lens_or_status(sensor)
    if isinstance(camera, Status):
        return camera
    intrinsics = find_ros_intrinsics(camera)
    if intrinsics is None:
        return failure_status(f"sensor_msgs/CameraInfo has no name for {camera.model}")
    head = [
        f"Camera {sensor.name} of rig {scene.rig}: {CONVENTION}.",
        *scene.describe_verdict(),
        format_worked_pixel(sensor.frame, camera),
        format_worked_point(sensor.frame, scene.parent_frame, sensor.T_parent_sensor),
    ]
    content = _camera_info_json(sensor.name, camera, intrinsics)
    return format_hash_comment(head) + yaml.safe_dump(content, sort_keys=False, width=1000)


def _camera_info_json(name: str, camera: CameraModel, intrinsics: RosIntrinsics) -> dict[str, Any]:
    width, height = camera.size_px
    D = intrinsics.D
    return {
        "image_width": width,
        "image_height": height,
        "camera_name": name,
        "camera_matrix": {"rows": 3, "cols": 3, "data": intrinsics.K},
        "distortion_model": intrinsics.distortion_model,
        "distortion_coefficients": {"rows": 1, "cols": len(D), "data": D},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": intrinsics.R},
        "projection_matrix": {"rows": 3, "cols": 4, "data": intrinsics.P},
    }
