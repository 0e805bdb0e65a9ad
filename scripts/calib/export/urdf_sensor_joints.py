"""Where joints of a robot's URDF must be for the sensors to sit where the calibration has them."""

import numpy as np

from calib.export.calibrated_scene import T_BODY_OPTICAL
from calib.geometry.frame_graph import lookup_transform
from calib.geometry.se3 import invert_pose, rotation_angle
from calib.io.status import did_you_mean, failure_status
from calib.io.urdf_file import fixed_joint_transforms

MAX_CONVENTION_TURN_RAD = (
    1e-3  # rad: a joint turned so little off REP 103's is a convention, not a mount
)


def compute_joint_origins(joints, scene):
    """({child link: T_parent_child (4, 4)}, {sensor: Status of why none}) of a URDF's joints.

    The joint above a sensor's frame is placed; where that is only the turn from a camera's body to
    its optical frame, the one above it. Joints higher up go first: sensors may hang on sensors.
    """
    by_child = {j.child: j for j in joints}
    known, placed, unplaced = fixed_joint_transforms(joints), {}, {}
    todo = [(_count_parent_joints(by_child, s.frame), n) for n, s in scene.sensors.items()]
    for _, name in sorted(todo):
        sensor = scene.sensors[name]
        if sensor.frame == scene.parent_frame:
            continue
        joint, T_child_sensor = _find_sensor_joint(sensor, by_child, placed)
        if joint is None:
            unplaced[name] = _missing_joint_status(sensor.frame, joints)
            continue
        why = _unusable_joint_status(joint, scene, known)
        if why:
            unplaced[name] = why
            continue
        rest = {k: T for k, T in known.items() if k != (joint.parent, joint.child)}
        T_parent_link = lookup_transform(rest, scene.parent_frame, joint.parent)
        T = invert_pose(T_parent_link) @ sensor.T_parent_sensor @ invert_pose(T_child_sensor)
        placed[joint.child] = known[joint.parent, joint.child] = T
    return placed, unplaced


def _count_parent_joints(by_child, link):
    """How many joints lie above a link."""
    seen = []
    while link in by_child and link not in seen:
        seen.append(link)
        link = by_child[link].parent
    return len(seen)


def _find_sensor_joint(sensor, by_child, joint_origins):
    """(the Joint to place for a sensor, T_child_sensor below it), or (None, None)."""
    joint = by_child.get(sensor.frame)
    if joint is None:
        return None, None
    above = by_child.get(joint.parent)
    turned = joint.T_parent_child is not None and rotation_angle(
        invert_pose(joint.T_parent_child) @ T_BODY_OPTICAL
    )
    optical = sensor.kind == "camera" and joint.type == "fixed" and joint.T_parent_child is not None
    if (
        optical
        and turned < MAX_CONVENTION_TURN_RAD
        and above is not None
        and above.child not in joint_origins
    ):
        return above, joint.T_parent_child
    return joint, np.eye(4)


def _missing_joint_status(frame, joints):
    remedy = did_you_mean(frame, [j.child for j in joints])
    remedy = remedy or "Add a link and a fixed joint of that name."
    return failure_status(
        f"no joint has the child link {frame}", "", "the frame of its messages", remedy
    )


def _unusable_joint_status(joint, scene, fixed_transforms):
    """Why a joint cannot be placed, or None."""
    if joint.type != "fixed":
        return failure_status(f"joint {joint.name} is {joint.type}", joint.type, "fixed")
    if joint.T_parent_child is None:
        return failure_status(
            f"joint {joint.name}: {joint.pose_error}", "", "three plain numbers each"
        )
    rest = {k: T for k, T in fixed_transforms.items() if k != (joint.parent, joint.child)}
    if lookup_transform(rest, scene.parent_frame, joint.parent) is None:
        return failure_status(
            f"no fixed joints lead from {scene.parent_frame} to {joint.parent}",
            remedy="State export.parent as a link that they join, with T_parent_robot.",
        )
    return None
