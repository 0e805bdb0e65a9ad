"""The cameras as a Kalibr camchain, each with its pose relative to the one before."""

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
from calib.geometry.se3 import invert_pose
from calib.io.status import Status, failure_status
from calib.sensors.camera.camera_model import CameraModel

TITLE = "the cameras for Kalibr and what reads its camchains"
FILE_PATTERNS: tuple[str, ...] = ("camchain.yaml",)
CONVENTION = (
    "T_cn_cnm1 (4 x 4) maps points of the camera before into this one's frame; intrinsics fu fv pu "
    "pv (ds: xi alpha first); pixel (0, 0) is the centre of the first pixel"
)


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render camchain.yaml of the cameras whose model Kalibr has."""
    blocks = {name: _camera_block(camera) for name, camera in scene.cameras.items()}
    out: dict[str, str | bytes | Status] = {
        f"camchain.yaml: {name}": block
        for name, block in blocks.items()
        if isinstance(block, Status)
    }
    chain: dict[str, dict[str, Any]] = {}
    head = [f"Cameras of rig {scene.rig}: {CONVENTION}.", *scene.describe_verdict()]
    previous: ExportSensor | None = None
    for name, block in blocks.items():
        if isinstance(block, Status):
            continue
        sensor, key = scene.cameras[name], f"cam{len(chain)}"
        chain[key] = block
        assert sensor.camera is not None  # it has a block
        head.append(f"{key} is {name}: {format_worked_pixel(sensor.frame, sensor.camera)}")
        if previous is not None:
            T = invert_pose(sensor.T_parent_sensor) @ previous.T_parent_sensor
            block["T_cn_cnm1"] = T.tolist()
            head.append(format_worked_point(previous.frame, sensor.frame, T))
        previous = sensor
    if not chain:
        return out | {"camchain.yaml": failure_status("Kalibr has a model for none of the cameras")}
    first = scene.cameras[next(n for n, b in blocks.items() if not isinstance(b, Status))]
    head.append(
        f"cam0: {format_worked_point(first.frame, scene.parent_frame, first.T_parent_sensor)}"
    )
    text = yaml.safe_dump(chain, default_flow_style=None, sort_keys=False, width=1000)
    return {"camchain.yaml": format_hash_comment(head) + text} | out


def _camera_block(sensor: ExportSensor) -> dict[str, Any] | Status:
    """Make the block of a camera without its pose, or say what Kalibr cannot express."""
    camera = lens_or_status(sensor)
    if isinstance(camera, Status):
        return camera
    model = convert_to_kalibr_model(sensor.name, camera)
    if isinstance(model, Status):
        return model
    size = list(camera.size_px)
    return model | {"resolution": size, "rostopic": sensor.topic, "cam_overlaps": []}


def convert_to_kalibr_model(name: str, camera: CameraModel) -> dict[str, Any] | Status:
    """Return Kalibr's camera and distortion model with their numbers, or what it cannot express."""
    fx, fy, cx, cy, *distortion = camera.params
    pinhole = {"camera_model": "pinhole", "intrinsics": [fx, fy, cx, cy]}
    if camera.model == "radtan":
        if distortion[4]:
            return failure_status(
                f"Kalibr's radtan has no k3, but {name} has k3 = {distortion[4]:g}"
            )
        return pinhole | {"distortion_model": "radtan", "distortion_coeffs": distortion[:4]}
    if camera.model == "kannala_brandt":
        return pinhole | {"distortion_model": "equidistant", "distortion_coeffs": distortion}
    if camera.model == "double_sphere":
        double_sphere = {"camera_model": "ds", "intrinsics": [*distortion, fx, fy, cx, cy]}
        return double_sphere | {"distortion_model": "none", "distortion_coeffs": []}
    return failure_status(f"{name}: the Kalibr export does not support {camera.model}")
