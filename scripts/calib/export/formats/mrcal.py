"""Each camera as an mrcal .cameramodel, a Python literal."""

import numpy as np

from calib.export.calibrated_scene import (
    format_hash_comment,
    format_worked_pixel,
    format_worked_point,
)
from calib.geometry.se3 import invert_pose, so3_log
from calib.io.status import failure_status

TITLE = "cameras for mrcal"
CONVENTION = (
    "extrinsics are rt_cam_ref, a rotation vector and a translation that map points of the "
    "reference frame into the camera's; radians, metres"
)


def render_files(scene):
    """<camera>.cameramodel of every camera."""
    return {f"{n}.cameramodel": _render_cameramodel(scene, s) for n, s in scene.cameras.items()}


def _render_cameramodel(scene, sensor):
    if sensor.camera is None:
        return failure_status(f"the parameters of {sensor.name} are not in its configuration")
    if sensor.camera.model != "radtan":
        return failure_status(f"mrcal has no lens model that is {sensor.camera.model}")
    T_camera_parent = invert_pose(sensor.T_parent_sensor)
    rt = [*so3_log(T_camera_parent[:3, :3]), *T_camera_parent[:3, 3]]
    head = [
        f"Camera {sensor.name} of rig {scene.rig}: {CONVENTION}. Reference: {scene.parent_frame}."
    ]
    head += [
        format_worked_pixel(sensor),
        format_worked_point(sensor.frame, scene.parent_frame, sensor.T_parent_sensor),
    ]
    content = {
        "lensmodel": "LENSMODEL_OPENCV5",
        "intrinsics": list(sensor.camera.params),
        "extrinsics": np.array(rt).tolist(),
        "imagersize": list(sensor.camera.size_px),
    }
    lines = "".join(f"    {key!r}: {value!r},\n" for key, value in content.items())
    return f"{format_hash_comment(head)}{{\n{lines}}}\n"
