"""Compute where the joints of a robot's URDF must be, so that the sensors sit as calibrated."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from calib.geometry.frame_graph import lookup_transform
from calib.geometry.se3 import invert_pose, make_pose, rotation_angle
from calib.io.status import Status, did_you_mean, failure_status
from calib.io.urdf.urdf_file import UrdfJoint, fixed_joint_transforms

# From x right, y down, z forward (image) to x forward, y left, z up (body), as REP 103 has them.
T_BODY_OPTICAL = make_pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
# A joint this close to REP 103's turn is a convention between frames, not a mount.
MAX_CONVENTION_TURN_RAD = 1e-3

FixedTransforms = dict[tuple[str, str], np.ndarray]


class MountedSensor(Protocol):
    """A sensor with the frame of its messages and its pose T_parent_sensor (4, 4)."""

    @property
    def name(self) -> str: ...

    @property
    def kind(self) -> str: ...

    @property
    def frame(self) -> str: ...

    @property
    def T_parent_sensor(self) -> np.ndarray: ...


class SensorJoints(NamedTuple):
    """New T_parent_child (4, 4) by child link, and by sensor why it has no joint to place."""

    origins: dict[str, np.ndarray]
    unplaced: dict[str, Status]


def compute_joint_origins(
    joints: Sequence[UrdfJoint], sensors: Iterable[MountedSensor], parent_frame: str
) -> SensorJoints:
    """Compute the origins of the joints above the sensors' frames; parent_frame is a link.

    If the joint is only the turn from a camera's body to its optical frame, the joint above it
    moves. Joints higher up are placed first: a sensor may hang on another sensor.
    """
    joint_by_child = {j.child: j for j in joints}
    transforms = fixed_joint_transforms(joints)
    origins: dict[str, np.ndarray] = {}
    unplaced: dict[str, Status] = {}
    by_height = sorted(
        sensors, key=lambda s: (_count_parent_joints(joint_by_child, s.frame), s.name)
    )
    for sensor in by_height:
        if sensor.frame == parent_frame:
            continue
        if sensor.frame not in joint_by_child:
            unplaced[sensor.name] = _missing_joint_status(sensor.frame, joints)
            continue
        joint, T_child_sensor = _find_sensor_joint(sensor, joint_by_child, origins)
        T_parent_link = _find_parent_link_pose(joint, parent_frame, transforms)
        if isinstance(T_parent_link, Status):
            unplaced[sensor.name] = T_parent_link
            continue
        T = invert_pose(T_parent_link) @ sensor.T_parent_sensor @ invert_pose(T_child_sensor)
        origins[joint.child] = transforms[joint.parent, joint.child] = T
    return SensorJoints(origins, unplaced)


def _count_parent_joints(joint_by_child: dict[str, UrdfJoint], link: str) -> int:
    """Count the joints above a link; a loop counts once."""
    visited: list[str] = []
    while link in joint_by_child and link not in visited:
        visited.append(link)
        link = joint_by_child[link].parent
    return len(visited)


def _find_sensor_joint(
    sensor: MountedSensor, joint_by_child: dict[str, UrdfJoint], origins: dict[str, np.ndarray]
) -> tuple[UrdfJoint, np.ndarray]:
    """Return the joint to place for a sensor and T_child_sensor (4, 4) below it."""
    joint = joint_by_child[sensor.frame]
    upper = joint_by_child.get(joint.parent)
    if (
        sensor.kind == "camera"
        and joint.type == "fixed"
        and joint.T_parent_child is not None
        and _is_optical_convention(joint.T_parent_child)
        and upper is not None
        and upper.child not in origins
    ):
        return upper, joint.T_parent_child
    return joint, np.eye(4)


def _is_optical_convention(T_parent_child: np.ndarray) -> bool:
    turn = rotation_angle(invert_pose(T_parent_child) @ T_BODY_OPTICAL)
    return bool(turn < MAX_CONVENTION_TURN_RAD)


def _missing_joint_status(frame: str, joints: Sequence[UrdfJoint]) -> Status:
    remedy = did_you_mean(frame, [j.child for j in joints])
    remedy = remedy or "Add a link and a fixed joint of that name."
    return failure_status(
        f"no joint has the child link {frame}", expected="the frame of its messages", remedy=remedy
    )


def _find_parent_link_pose(
    joint: UrdfJoint, parent_frame: str, transforms: FixedTransforms
) -> np.ndarray | Status:
    """Return T_parent_link (4, 4) of the link above a joint, or why the joint cannot be placed."""
    if joint.type != "fixed":
        return failure_status(f"joint {joint.name} is {joint.type}", joint.type, "fixed")
    if joint.T_parent_child is None:
        return failure_status(
            f"joint {joint.name}: {joint.pose_error}", expected="three plain numbers each"
        )
    others = {edge: T for edge, T in transforms.items() if edge != (joint.parent, joint.child)}
    T_parent_link = lookup_transform(others, parent_frame, joint.parent)
    if T_parent_link is None:
        return failure_status(
            f"no fixed joints lead from {parent_frame} to {joint.parent}",
            remedy="Set export.parent to a link that they join, with T_parent_robot.",
        )
    return T_parent_link
