"""Each camera as an mrcal .cameramodel, a Python literal."""

import numpy as np

from calib.export.calibrated_scene import (
    ExportScene,
    ExportSensor,
    format_hash_comment,
    format_worked_pixel,
    format_worked_point,
    lens_or_status,
)
from calib.geometry.se3 import invert_pose, so3_log
from calib.io.status import Status, failure_status

TITLE = "cameras for mrcal"
FILE_PATTERNS: tuple[str, ...] = ("*.cameramodel",)
CONVENTION = (
    "extrinsics are rt_cam_ref, a rotation vector and a translation that map points of the "
    "reference frame into the camera's; radians, metres"
)


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render <camera>.cameramodel of every camera."""
    return {f"{n}.cameramodel": _render_cameramodel(scene, s) for n, s in scene.cameras.items()}


def _render_cameramodel(scene: ExportScene, sensor: ExportSensor) -> str | Status:
    camera = lens_or_status(sensor)
    if isinstance(camera, Status):
        return camera
    if camera.model != "radtan":
        return failure_status(f"mrcal has no lens model for {camera.model}")
    T_camera_parent = invert_pose(sensor.T_parent_sensor)
    rt = [*so3_log(T_camera_parent[:3, :3]), *T_camera_parent[:3, 3]]
    head = [
        f"Camera {sensor.name} of rig {scene.rig}: {CONVENTION}. Reference: {scene.parent_frame}.",
        *scene.describe_verdict(),
        format_worked_pixel(sensor.frame, camera),
        format_worked_point(sensor.frame, scene.parent_frame, sensor.T_parent_sensor),
    ]
    content = {
        "lensmodel": "LENSMODEL_OPENCV5",
        "intrinsics": list(camera.params),
        "extrinsics": np.array(rt).tolist(),
        "imagersize": list(camera.size_px),
    }
    lines = "".join(f"    {key!r}: {value!r},\n" for key, value in content.items())
    return f"{format_hash_comment(head)}{{\n{lines}}}\n"
