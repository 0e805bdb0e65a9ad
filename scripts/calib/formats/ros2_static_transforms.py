"""ROS 2 static transforms as YAML: geometry_msgs/msg/TransformStamped by sensor."""

import numpy as np
import yaml

from calib import geometry

FILE = "static_transforms.yaml"
HEADER = """\
# Static transforms of rig {rig} for ROS 2: each maps points of child_frame_id into frame_id,
# p_parent = R(rotation) p_child + translation. Metres; quaternions x y z w.
"""


def render(calibration, parent):
    """The file's text: every solved sensor, its direction in words, and one worked point."""
    transforms, notes = [], []
    for name, sensor in sorted(calibration["sensors"].items()):
        if sensor["T_robot_sensor"] is None:
            notes.append(f"# {name} is left out: {sensor['status']['reason']}")
            continue
        transforms.append(_transform(sensor, parent))
        notes.append(_worked_point(name, sensor, parent))
    body = yaml.safe_dump({"transforms": transforms}, sort_keys=False)
    return HEADER.format(rig=calibration["rig"]) + "\n".join(notes) + "\n" + body


def _transform(sensor, parent):
    xyz, quat = sensor["T_robot_sensor"]["xyz_m"], sensor["T_robot_sensor"]["quat_xyzw"]
    return {
        "header": {"frame_id": parent},
        "child_frame_id": sensor["frame"],
        "transform": {
            "translation": dict(zip("xyz", xyz, strict=True)),
            "rotation": dict(zip("xyzw", quat, strict=True)),
        },
    }


def _worked_point(name, sensor, parent):
    T = np.array(sensor["T_robot_sensor"]["matrix"])
    x, y, z = geometry.transform(T, np.array([1.0, 0.0, 0.0]))
    there = f"({x:.6f}, {y:.6f}, {z:.6f})"
    return f"# {name}: the point (1, 0, 0) of {sensor['frame']} is {there} in {parent}"
