"""Motion capture messages: which types carry poses of bodies, and how.

To add a type: a function of the message that gives its Poses, in the file of its family, and one
line in TYPES.
"""

from calib.io.status import InputError, in_a_line
from calib.mocap.messages import named_bodies, single_pose, tf, vicon

LATEST = 1 << 62  # ns
TYPES = {
    "tf2_msgs/msg/TFMessage": tf.message,
    "tf/msg/tfMessage": tf.message,
    "geometry_msgs/msg/TransformStamped": tf.one,
    "geometry_msgs/msg/PoseStamped": single_pose.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": single_pose.with_covariance,
    "nav_msgs/msg/Odometry": single_pose.odometry,
    "mocap4r2_msgs/msg/RigidBodies": named_bodies.rigid_bodies,
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": named_bodies.named_poses,
    "vicon_receiver/msg/Position": vicon.position,
    "vicon_msgs/msg/Position": vicon.position,
}


def poses(message):
    """The Poses of a Message of one of TYPES; raises InputError where it cannot be read."""
    content = message.content
    try:
        return [_checked(pose) for pose in TYPES[message.type](content)]
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"a message of {message.type} has other fields than that type ({in_a_line(error)})"
        ) from error


def _checked(pose):
    """The Pose, if a definition of the log's own made its fields what they should be."""
    if not (isinstance(pose.parent, str) and isinstance(pose.body, str)):
        raise TypeError("names that are no text")
    if pose.t is not None and not -LATEST < pose.t < LATEST:
        raise ValueError("a stamp beyond all times")
    return pose._replace(xyz=tuple(map(float, pose.xyz)), quat=tuple(map(float, pose.quat)))
