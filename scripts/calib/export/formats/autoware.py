"""Autoware's sensor_kit_calibration.yaml: lidars, and cameras by their bodies."""

import numpy as np
import yaml

from calib.export.calibrated_scene import (
    ExportScene,
    ExportSensor,
    format_hash_comment,
    format_worked_point,
)
from calib.geometry.se3 import invert_pose, pose_to_rpy
from calib.io.status import Status
from calib.io.urdf.sensor_joints import T_BODY_OPTICAL

TITLE = "sensor_kit_calibration.yaml of Autoware; its parent is meant to be sensor_kit_base_link"
FILE_PATTERNS: tuple[str, ...] = ("sensor_kit_calibration.yaml",)
CONVENTION = (
    "x y z roll pitch yaw map points of the named frame into the parent, R = Rz(yaw) Ry(pitch) "
    "Rx(roll); metres, radians; camera_link has x forward, y left, z up"
)


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render sensor_kit_calibration.yaml."""
    head = [f"Sensors of rig {scene.rig}: {CONVENTION}.", *scene.describe_verdict()]
    poses = {}
    for sensor in scene.sensors.values():
        if sensor.frame == scene.parent_frame:
            continue
        frame, T = _mounted_frame(sensor)
        numbers = [*T[:3, 3].tolist(), *pose_to_rpy(T).tolist()]
        poses[frame] = dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), numbers, strict=True))
        head.append(f"{sensor.name}: {format_worked_point(frame, scene.parent_frame, T)}")
    head += scene.describe_missing_sensors()
    text = yaml.safe_dump({scene.parent_frame: poses}, sort_keys=False)
    return {"sensor_kit_calibration.yaml": format_hash_comment(head) + text}


def _mounted_frame(sensor: ExportSensor) -> tuple[str, np.ndarray]:
    """Return the name and pose (4, 4) of the frame that Autoware mounts: of a camera its body."""
    if sensor.kind != "camera":
        return sensor.frame, sensor.T_parent_sensor
    frame = sensor.body_frame or f"{sensor.name}/camera_link"
    return frame, sensor.T_parent_sensor @ invert_pose(T_BODY_OPTICAL)
