"""Motion capture messages: which types carry poses of bodies, and how.

To add a type: a function of the message that gives its Poses, in the file of its family, and one
line in TYPES.
"""

from calib.mcs import arrays, stamped, transforms, vicon
from calib.status import InputError, in_a_line

TYPES = {
    "tf2_msgs/msg/TFMessage": transforms.message,
    "tf/msg/tfMessage": transforms.message,
    "geometry_msgs/msg/TransformStamped": transforms.one,
    "geometry_msgs/msg/PoseStamped": stamped.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": stamped.with_covariance,
    "nav_msgs/msg/Odometry": stamped.odometry,
    "mocap4r2_msgs/msg/RigidBodies": arrays.rigid_bodies,
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": arrays.named_poses,
    "vicon_receiver/msg/Position": vicon.position,
    "vicon_msgs/msg/Position": vicon.position,
}


def poses(message):
    """The Poses of a Message of one of TYPES; raises InputError where it cannot be read."""
    try:
        return TYPES[message.type](message.content)
    except (AttributeError, TypeError) as error:
        raise InputError(
            f"a message of {message.type} has other fields than that type ({in_a_line(error)})"
        ) from error
