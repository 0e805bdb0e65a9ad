"""One pose in a message; the topic names the body, if the message does not."""

from calib.mocap.messages.body_pose import Pose, parts, stamp_ns


def pose(content):
    """The pose of a PoseStamped."""
    return [_pose(content.header, "", content.pose)]


def with_covariance(content):
    """The pose of a PoseWithCovarianceStamped; its covariance is the driver's guess."""
    return [_pose(content.header, "", content.pose.pose)]


def odometry(content):
    """The pose of an Odometry, of the body that its child frame names, if it does."""
    return [_pose(content.header, content.child_frame_id, content.pose.pose)]


def _pose(header, body, found):
    values = parts(found.position, found.orientation)
    return Pose(header.frame_id, body, stamp_ns(header), *values, several=False)
