"""Messages with several named bodies under one header."""

from collections.abc import Iterable
from typing import Any

from calib.mocap.messages.body_pose import MocapPose, make_mocap_pose


def read_rigid_bodies(content: Any) -> list[MocapPose]:
    """Return the poses of a mocap4r2_msgs/RigidBodies."""
    return _make_poses(content.header, [(b.rigid_body_name, b.pose) for b in content.rigidbodies])


def read_named_poses(content: Any) -> list[MocapPose]:
    """Return the poses of a motion_capture_tracking_interfaces/NamedPoseArray."""
    return _make_poses(content.header, [(b.name, b.pose) for b in content.poses])


def _make_poses(header: Any, named_poses: Iterable[tuple[str, Any]]) -> list[MocapPose]:
    return [
        make_mocap_pose(header, body, position=pose.position, orientation=pose.orientation)
        for body, pose in named_poses
    ]
