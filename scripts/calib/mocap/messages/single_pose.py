"""Messages with one pose; the topic names the body if the message does not."""

from typing import Any

from calib.mocap.messages.body_pose import MocapPose, make_mocap_pose


def read_pose_stamped(content: Any) -> list[MocapPose]:
    """Return the pose of a PoseStamped."""
    return [_make_pose(content.header, "", content.pose)]


def read_pose_with_covariance(content: Any) -> list[MocapPose]:
    """Return the pose of a PoseWithCovarianceStamped; the driver's covariance is not used."""
    return [_make_pose(content.header, "", content.pose.pose)]


def read_odometry(content: Any) -> list[MocapPose]:
    """Return the pose of an Odometry; its child frame, if set, names the body."""
    return [_make_pose(content.header, content.child_frame_id, content.pose.pose)]


def _make_pose(header: Any, body: str, pose: Any) -> MocapPose:
    return make_mocap_pose(
        header, body, position=pose.position, orientation=pose.orientation, is_multi_body=False
    )
