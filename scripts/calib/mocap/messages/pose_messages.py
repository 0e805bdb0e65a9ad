"""Motion capture messages: which types carry poses of bodies, and how.

To add a type: a function of the message that gives its Poses, in the file of its family, and one
line in TYPES.
"""

from calib.io.status import InputError, summarize_error
from calib.mocap.messages.named_bodies import read_named_poses, read_rigid_bodies
from calib.mocap.messages.single_pose import (
    read_odometry,
    read_pose_stamped,
    read_pose_with_covariance,
)
from calib.mocap.messages.tf import read_tf_message, read_transform_stamped
from calib.mocap.messages.vicon import read_vicon_position

MAX_STAMP_NS = 1 << 62  # ns
POSE_READERS = {
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


def read_poses(message):
    """The Poses of a Message of one of TYPES; raises InputError where it cannot be read."""
    content = message.content
    try:
        return [_check_pose(pose) for pose in POSE_READERS[message.type](content)]
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"a message of {message.type} has other fields than that type ({summarize_error(error)})"
        ) from error


def _check_pose(pose):
    """The Pose, if a definition of the log's own made its fields what they should be."""
    if not (isinstance(pose.parent, str) and isinstance(pose.body, str)):
        raise TypeError("names that are no text")
    if pose.stamp_ns is not None and not -MAX_STAMP_NS < pose.stamp_ns < MAX_STAMP_NS:
        raise ValueError("a stamp beyond all times")
    return pose._replace(xyz=tuple(map(float, pose.xyz)), quat=tuple(map(float, pose.quat)))
