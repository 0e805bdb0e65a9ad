"""The cameras as a Kalibr camchain, each with its pose against the one before."""

import yaml

from calib.export.calibrated_scene import (
    format_hash_comment,
    format_worked_pixel,
    format_worked_point,
)
from calib.geometry.se3 import invert_pose
from calib.io.status import failure_status

TITLE = "the cameras for Kalibr and what reads its camchains"
CONVENTION = (
    "T_cn_cnm1 (4 x 4) maps points of the camera before into this one's frame; intrinsics fu fv pu "
    "pv (ds: xi alpha first); pixel (0, 0) is the centre of the first pixel"
)


def render_files(scene):
    """camchain.yaml of the cameras that Kalibr has a model for."""
    models = {n: convert_to_kalibr_model(s) for n, s in scene.cameras.items()}
    unsaid = {f"camchain.yaml: {n}": m for n, m in models.items() if not isinstance(m, dict)}
    used = [s for n, s in scene.cameras.items() if isinstance(models[n], dict)]
    if not used:
        return unsaid | {"camchain.yaml": failure_status("no camera that Kalibr has a model for")}
    chain, head = {}, [f"Cameras of rig {scene.rig}: {CONVENTION}."]
    for i, sensor in enumerate(used):
        chain[f"cam{i}"] = models[sensor.name] | _camera_metadata(sensor)
        head.append(f"cam{i} is {sensor.name}: {format_worked_pixel(sensor)}")
        if i:
            T = invert_pose(sensor.T_parent_sensor) @ used[i - 1].T_parent_sensor
            chain[f"cam{i}"]["T_cn_cnm1"] = T.tolist()
            head.append(format_worked_point(used[i - 1].frame, sensor.frame, T))
    head.append(
        f"cam0: {format_worked_point(used[0].frame, scene.parent_frame, used[0].T_parent_sensor)}"
    )
    text = yaml.safe_dump(chain, default_flow_style=None, sort_keys=False, width=1000)
    return {"camchain.yaml": format_hash_comment(head) + text} | unsaid


def convert_to_kalibr_model(sensor):
    """Camera and distortion model with their numbers, or the Status of what Kalibr cannot say."""
    if sensor.camera is None:
        return failure_status(f"the parameters of {sensor.name} are not in its configuration")
    fx, fy, cx, cy, *rest = sensor.camera.params
    pinhole = {"camera_model": "pinhole", "intrinsics": [fx, fy, cx, cy]}
    if sensor.camera.model == "radtan":
        if rest[4]:
            return failure_status(
                f"Kalibr's radtan has no k3, that of {sensor.name} is {rest[4]:g}"
            )
        return pinhole | {"distortion_model": "radtan", "distortion_coeffs": rest[:4]}
    if sensor.camera.model == "kannala_brandt":
        return pinhole | {"distortion_model": "equidistant", "distortion_coeffs": rest}
    if sensor.camera.model == "double_sphere":
        numbers = {"camera_model": "ds", "intrinsics": [*rest, fx, fy, cx, cy]}
        return numbers | {"distortion_model": "none", "distortion_coeffs": []}
    return failure_status(f"this version does not write {sensor.camera.model} for Kalibr")


def _camera_metadata(sensor):
    size = list(sensor.camera.size_px)
    return {"resolution": size, "rostopic": sensor.topic, "cam_overlaps": []}
