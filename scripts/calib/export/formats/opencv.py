"""All sensors for OpenCV's FileStorage: poses, and cameras as its functions take them."""

import cv2
import numpy as np

from calib.export.calibrated_scene import format_worked_pixel
from calib.io.status import OK, failure_status

TITLE = "poses and intrinsics for cv::FileStorage"
CONVENTION = (
    "T_parent_sensor (4 x 4) maps points of the sensor's frame into parent; for cv::projectPoints "
    "take its inverse; metres, pixels"
)
# Functions that take its coefficients, how many there are.
OPENCV_CAMERA_MODELS = {"radtan": ("cv", 5), "kannala_brandt": ("cv::fisheye", 4)}


def render_files(scene):
    """opencv.yaml, and why some camera's intrinsics are not in it."""
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML
    file = cv2.FileStorage("", flags)
    for line in [f"Sensors of rig {scene.rig}: {CONVENTION}.", *scene.describe_worked_points()]:
        file.writeComment(" ".join(line.split()))
    file.write("parent", scene.parent_frame)
    file.startWriteStruct("sensors", cv2.FILE_NODE_SEQ)
    for sensor in scene.sensors.values():
        file.startWriteStruct("", cv2.FILE_NODE_MAP)
        _write_sensor(file, sensor)
        file.endWriteStruct()
    file.endWriteStruct()
    unsaid = {
        f"opencv.yaml: intrinsics of {n}": status
        for n, s in scene.cameras.items()
        if not (status := check_opencv_model(s)).ok
    }
    return {"opencv.yaml": file.releaseAndGetString()} | unsaid


def check_opencv_model(sensor):
    """Whether OpenCV has the camera's model."""
    if sensor.camera is None:
        return failure_status(f"the parameters of {sensor.name} are not in its configuration")
    if sensor.camera.model not in OPENCV_CAMERA_MODELS:
        return failure_status(f"OpenCV has no functions for {sensor.camera.model}")
    return OK


def _write_sensor(file, sensor):
    for key, value in (("name", sensor.name), ("kind", sensor.kind), ("frame", sensor.frame)):
        file.write(key, value)
    file.write("T_parent_sensor", sensor.T_parent_sensor)
    if sensor.kind != "camera" or not check_opencv_model(sensor).ok:
        return
    functions, count = OPENCV_CAMERA_MODELS[sensor.camera.model]
    fx, fy, cx, cy, *distortion = sensor.camera.params
    file.writeComment(format_worked_pixel(sensor))
    file.write("functions", functions)
    file.write("image_width", sensor.camera.size_px[0])
    file.write("image_height", sensor.camera.size_px[1])
    file.write("camera_matrix", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]))
    file.write("distortion_coefficients", np.array([distortion[:count]]))
