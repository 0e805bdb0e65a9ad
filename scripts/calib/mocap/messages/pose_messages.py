"""Registry of the message types that carry poses of bodies.

To add a type: write a function that follows PoseReader, in the file of its family, and add a line
to POSE_READERS.
"""

from typing import Any, Protocol

from calib.io.logs.log_message import LogMessage
from calib.io.safe_names import NameGate
from calib.io.status import InputError, summarize_error
from calib.mocap.messages.body_pose import MocapPose
from calib.mocap.messages.named_bodies import read_named_poses, read_rigid_bodies
from calib.mocap.messages.single_pose import (
    read_odometry,
    read_pose_stamped,
    read_pose_with_covariance,
)
from calib.mocap.messages.tf import read_tf_message, read_transform_stamped
from calib.mocap.messages.vicon import read_vicon_position

MAX_STAMP_NS = 1 << 62


class PoseReader(Protocol):
    """Reads the poses of the decoded messages of one type."""

    def __call__(self, content: Any, /) -> list[MocapPose]:
        """Return the poses as the message states them."""


POSE_READERS: dict[str, PoseReader] = {
    "tf2_msgs/msg/TFMessage": read_tf_message,
    "tf/msg/tfMessage": read_tf_message,
    "geometry_msgs/msg/TransformStamped": read_transform_stamped,
    "geometry_msgs/msg/PoseStamped": read_pose_stamped,
    "geometry_msgs/msg/PoseWithCovarianceStamped": read_pose_with_covariance,
    "nav_msgs/msg/Odometry": read_odometry,
    "mocap4r2_msgs/msg/RigidBodies": read_rigid_bodies,
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": read_named_poses,
    "vicon_receiver/msg/Position": read_vicon_position,
    "vicon_msgs/msg/Position": read_vicon_position,
}


def read_poses(message: LogMessage, names: NameGate) -> list[MocapPose]:
    """Return the poses of a message of a type in POSE_READERS; raises InputError if unreadable.

    names: the gate that the names of frames and bodies pass.
    """
    content = message.content
    try:
        return [_check_pose(pose, names) for pose in POSE_READERS[message.type](content)]
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"a message of {message.type} does not have the fields of that type "
            f"({summarize_error(error)})"
        ) from error


def _check_pose(pose: MocapPose, names: NameGate) -> MocapPose:
    """Return the pose with safe names if its fields have the types and ranges they should have."""
    if not (isinstance(pose.parent, str) and isinstance(pose.body, str)):
        raise TypeError("names that are not text")
    if pose.stamp_ns is not None and not -MAX_STAMP_NS < pose.stamp_ns < MAX_STAMP_NS:
        raise ValueError("a stamp out of range")
    return pose._replace(
        parent=names.admit(pose.parent),
        body=names.admit(pose.body),
        xyz=tuple(map(float, pose.xyz)),
        quat=tuple(map(float, pose.quat)),
    )
