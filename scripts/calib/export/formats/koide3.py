"""Every lidar with every camera as the calib.json of koide3's direct_visual_lidar_calibration."""

import json

from calib.export.calibrated_scene import worked_pixel, worked_point
from calib.geometry import se3
from calib.io.status import failed

TITLE = "calib.json of direct_visual_lidar_calibration, a folder for every lidar and camera"
CONVENTION = (
    "T_lidar_camera, x y z qx qy qz qw, maps points of the camera's frame into the lidar's; metres"
)
MODELS = {"radtan": ("plumb_bob", 5), "kannala_brandt": ("fisheye", 4)}  # name, numbers


def render(scene):
    """koide3/<lidar>/<camera>/calib.json of every pair."""
    return {
        f"koide3/{lidar.name}/{camera.name}/calib.json": _file(lidar, camera)
        for lidar in scene.lidars.values()
        for camera in scene.cameras.values()
    }


def _file(lidar, sensor):
    if sensor.camera is None:
        return failed(f"the parameters of {sensor.name} are not in its configuration")
    if sensor.camera.model not in MODELS:
        return failed(f"direct_visual_lidar_calibration has no model {sensor.camera.model}")
    name, count = MODELS[sensor.camera.model]
    T = se3.inverse(lidar.T) @ sensor.T
    pose = [*T[:3, 3].tolist(), *se3.to_quat(T).tolist()]
    content = {
        "about": {
            "convention": CONVENTION,
            "worked_point": worked_point(sensor.frame, lidar.frame, T),
            "worked_pixel": worked_pixel(sensor),
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
