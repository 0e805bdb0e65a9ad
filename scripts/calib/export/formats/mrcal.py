"""Each camera as an mrcal .cameramodel, a Python literal."""

import numpy as np

from calib.export.calibrated_scene import comment, worked_pixel, worked_point
from calib.geometry import se3
from calib.io.status import failed

TITLE = "cameras for mrcal"
CONVENTION = (
    "extrinsics are rt_cam_ref, a rotation vector and a translation that map points of the "
    "reference frame into the camera's; radians, metres"
)


def render(scene):
    """<camera>.cameramodel of every camera."""
    return {f"{n}.cameramodel": _file(scene, s) for n, s in scene.cameras.items()}


def _file(scene, sensor):
    if sensor.camera is None:
        return failed(f"the parameters of {sensor.name} are not in its configuration")
    if sensor.camera.model != "radtan":
        return failed(f"mrcal has no lens model that is {sensor.camera.model}")
    T_camera_parent = se3.inverse(sensor.T)
    rt = [*se3.so3_log(T_camera_parent[:3, :3]), *T_camera_parent[:3, 3]]
    head = [f"Camera {sensor.name} of rig {scene.rig}: {CONVENTION}. Reference: {scene.parent}."]
    head += [worked_pixel(sensor), worked_point(sensor.frame, scene.parent, sensor.T)]
    content = {
        "lensmodel": "LENSMODEL_OPENCV5",
        "intrinsics": list(sensor.camera.params),
        "extrinsics": np.array(rt).tolist(),
        "imagersize": list(sensor.camera.size),
    }
    lines = "".join(f"    {key!r}: {value!r},\n" for key, value in content.items())
    return f"{comment(head)}{{\n{lines}}}\n"
