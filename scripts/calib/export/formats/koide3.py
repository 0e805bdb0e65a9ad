"""Every lidar with every camera as the calib.json of koide3's direct_visual_lidar_calibration."""

import json

from calib.export.calibrated_scene import format_worked_pixel, format_worked_point
from calib.geometry.se3 import invert_pose, pose_to_quat
from calib.io.status import failure_status

TITLE = "calib.json of direct_visual_lidar_calibration, a folder for every lidar and camera"
CONVENTION = (
    "T_lidar_camera, x y z qx qy qz qw, maps points of the camera's frame into the lidar's; metres"
)
KOIDE3_CAMERA_MODELS = {
    "radtan": ("plumb_bob", 5),
    "kannala_brandt": ("fisheye", 4),
}  # name, numbers


def render_files(scene):
    """koide3/<lidar>/<camera>/calib.json of every pair."""
    return {
        f"koide3/{lidar.name}/{camera.name}/calib.json": _render_calib_json(lidar, camera)
        for lidar in scene.lidars.values()
        for camera in scene.cameras.values()
    }


def _render_calib_json(lidar, sensor):
    if sensor.camera is None:
        return failure_status(f"the parameters of {sensor.name} are not in its configuration")
    if sensor.camera.model not in KOIDE3_CAMERA_MODELS:
        return failure_status(f"direct_visual_lidar_calibration has no model {sensor.camera.model}")
    name, count = KOIDE3_CAMERA_MODELS[sensor.camera.model]
    T = invert_pose(lidar.T_parent_sensor) @ sensor.T_parent_sensor
    pose = [*T[:3, 3].tolist(), *pose_to_quat(T).tolist()]
    content = {
        "about": {
            "convention": CONVENTION,
            "worked_point": format_worked_point(sensor.frame, lidar.frame, T),
            "worked_pixel": format_worked_pixel(sensor),
        },
        "camera": {
            "camera_model": name,
            "intrinsics": list(sensor.camera.params[:4]),
            "distortion_coeffs": list(sensor.camera.params[4 : 4 + count]),
        },
        "meta": {"image_topic": sensor.topic, "points_topic": lidar.topic},
        "results": {"T_lidar_camera": pose},
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"
