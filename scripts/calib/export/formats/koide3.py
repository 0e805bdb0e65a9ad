"""Every lidar with every camera as calib.json of koide3's direct_visual_lidar_calibration."""

import json

from calib.export.calibrated_scene import (
    ExportScene,
    ExportSensor,
    format_worked_pixel,
    format_worked_point,
    lens_or_status,
)
from calib.geometry.se3 import invert_pose, pose_to_quat
from calib.io.status import Status, failure_status

TITLE = "calib.json of direct_visual_lidar_calibration, a folder for every lidar and camera"
FILE_PATTERNS: tuple[str, ...] = ("koide3/*/*/calib.json",)
CONVENTION = (
    "T_lidar_camera, x y z qx qy qz qw, maps points of the camera's frame into the lidar's; metres"
)
# By camera model: its name there, and how many distortion coefficients it has.
KOIDE3_CAMERA_MODELS = {"radtan": ("plumb_bob", 5), "kannala_brandt": ("fisheye", 4)}


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render koide3/<lidar>/<camera>/calib.json of every pair."""
    return {
        f"koide3/{lidar.name}/{camera.name}/calib.json": _render_calib_json(scene, lidar, camera)
        for lidar in scene.lidars.values()
        for camera in scene.cameras.values()
    }


def _render_calib_json(
    scene: ExportScene, lidar: ExportSensor, sensor: ExportSensor
) -> str | Status:
    camera = lens_or_status(sensor)
    if isinstance(camera, Status):
        return camera
    if camera.model not in KOIDE3_CAMERA_MODELS:
        return failure_status(f"direct_visual_lidar_calibration has no model {camera.model}")
    name, n_coefficients = KOIDE3_CAMERA_MODELS[camera.model]
    T_lidar_camera = invert_pose(lidar.T_parent_sensor) @ sensor.T_parent_sensor
    content = {
        "about": {
            "convention": CONVENTION,
            "verdict": scene.describe_verdict() or [scene.verdict],
            "worked_point": format_worked_point(sensor.frame, lidar.frame, T_lidar_camera),
            "worked_pixel": format_worked_pixel(sensor.frame, camera),
        },
        "camera": {
            "camera_model": name,
            "intrinsics": list(camera.params[:4]),
            "distortion_coeffs": list(camera.params[4 : 4 + n_coefficients]),
        },
        "meta": {"image_topic": sensor.topic, "points_topic": lidar.topic},
        "results": {
            "T_lidar_camera": [
                *T_lidar_camera[:3, 3].tolist(),
                *pose_to_quat(T_lidar_camera).tolist(),
            ]
        },
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"
