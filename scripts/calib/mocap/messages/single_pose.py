"""One pose in a message; the topic names the body, if the message does not."""

from calib.mocap.messages.body_pose import MocapPose, stamp_ns_or_none, to_xyz_and_quat


def read_pose_stamped(content):
    """The pose of a PoseStamped."""
    return [_make_pose(content.header, "", content.pose)]


def read_pose_with_covariance(content):
    """The pose of a PoseWithCovarianceStamped; its covariance is the driver's guess."""
    return [_make_pose(content.header, "", content.pose.pose)]


def read_odometry(content):
    """The pose of an Odometry, of the body that its child frame names, if it does."""
    return [_make_pose(content.header, content.child_frame_id, content.pose.pose)]


def _make_pose(header, body, pose):
    values = to_xyz_and_quat(pose.position, pose.orientation)
    return MocapPose(header.frame_id, body, stamp_ns_or_none(header), *values, is_multi_body=False)
