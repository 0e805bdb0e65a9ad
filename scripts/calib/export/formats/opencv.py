"""All sensors for OpenCV's FileStorage: poses, and cameras as its functions take them."""

import cv2
import numpy as np

from calib.export.calibrated_scene import (
    ExportScene,
    ExportSensor,
    format_worked_pixel,
    lens_or_status,
)
from calib.io.status import Status, failure_status
from calib.sensors.camera.camera_model import CameraModel

TITLE = "poses and intrinsics for cv::FileStorage"
FILE_PATTERNS: tuple[str, ...] = ("opencv.yaml",)
CONVENTION = (
    "T_parent_sensor (4 x 4) maps points of the sensor's frame into parent; for cv::projectPoints "
    "take its inverse; metres, pixels"
)
# By camera model: the functions that take its coefficients, and how many these are.
OPENCV_CAMERA_MODELS = {"radtan": ("cv", 5), "kannala_brandt": ("cv::fisheye", 4)}


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render opencv.yaml, and why the intrinsics of some camera are not in it."""
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML
    file = cv2.FileStorage("", flags)
    head = [f"Sensors of rig {scene.rig}: {CONVENTION}.", *scene.describe_verdict()]
    for line in [*head, *scene.describe_worked_points()]:
        file.writeComment(" ".join(line.split()))
    file.write("parent", scene.parent_frame)
    file.startWriteStruct("sensors", cv2.FILE_NODE_SEQ)
    missing: dict[str, str | bytes | Status] = {}
    for sensor in scene.sensors.values():
        file.startWriteStruct("", cv2.FILE_NODE_MAP)
        _write_pose(file, sensor)
        if sensor.kind == "camera":
            camera = _opencv_lens_or_status(sensor)
            if isinstance(camera, Status):
                missing[f"opencv.yaml: intrinsics of {sensor.name}"] = camera
            else:
                _write_intrinsics(file, sensor.frame, camera)
        file.endWriteStruct()
    file.endWriteStruct()
    return {"opencv.yaml": file.releaseAndGetString()} | missing


def _opencv_lens_or_status(sensor: ExportSensor) -> CameraModel | Status:
    """Return the camera model of a camera, or why OpenCV cannot use it."""
    camera = lens_or_status(sensor)
    if isinstance(camera, CameraModel) and camera.model not in OPENCV_CAMERA_MODELS:
        return failure_status(f"OpenCV has no functions for {camera.model}")
    return camera


def _write_pose(file: cv2.FileStorage, sensor: ExportSensor) -> None:
    for key, value in (("name", sensor.name), ("kind", sensor.kind), ("frame", sensor.frame)):
        file.write(key, value)
    file.write("T_parent_sensor", sensor.T_parent_sensor)


def _write_intrinsics(file: cv2.FileStorage, frame: str, camera: CameraModel) -> None:
    functions, n_coefficients = OPENCV_CAMERA_MODELS[camera.model]
    fx, fy, cx, cy, *distortion = camera.params
    file.writeComment(format_worked_pixel(frame, camera))
    file.write("functions", functions)
    file.write("image_width", camera.size_px[0])
    file.write("image_height", camera.size_px[1])
    file.write("camera_matrix", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]))
    file.write("distortion_coefficients", np.array([distortion[:n_coefficients]]))
