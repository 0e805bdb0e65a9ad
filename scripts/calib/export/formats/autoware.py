"""Autoware's sensor_kit_calibration.yaml: cameras by their bodies, from which it goes on itself."""

import yaml

from calib.export.calibrated_scene import T_BODY_OPTICAL, comment, worked_point
from calib.geometry import se3

TITLE = "sensor_kit_calibration.yaml of Autoware; its parent is meant to be sensor_kit_base_link"
CONVENTION = (
    "x y z roll pitch yaw map points of the named frame into the parent, R = Rz(yaw) Ry(pitch) "
    "Rx(roll); metres, radians; camera_link has x forward, y left, z up"
)


def render(scene):
    """sensor_kit_calibration.yaml."""
    poses, head = {}, [f"Sensors of rig {scene.rig}: {CONVENTION}."]
    for sensor in scene.sensors.values():
        if sensor.frame == scene.parent:
            continue
        frame, T = _mounted(sensor)
        numbers = [*T[:3, 3].tolist(), *se3.to_rpy(T).tolist()]
        poses[frame] = dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), numbers, strict=True))
        head.append(f"{sensor.name}: {worked_point(frame, scene.parent, T)}")
    head += [f"{n} is left out: {why}" for n, why in sorted(scene.left_out.items())]
    text = yaml.safe_dump({scene.parent: poses}, sort_keys=False)
    return {"sensor_kit_calibration.yaml": comment(head) + text}


def _mounted(sensor):
    """(frame, T_parent_frame) of what Autoware mounts: of a camera its body."""
    if sensor.kind != "camera":
        return sensor.frame, sensor.T
    frame = sensor.body or f"{sensor.name}/camera_link"
    return frame, sensor.T @ se3.inverse(T_BODY_OPTICAL)
