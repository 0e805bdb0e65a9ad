"""Several named bodies in one message, under one header."""

from calib.mocap.messages.body_pose import MocapPose, stamp_ns_or_none, to_xyz_and_quat


def read_rigid_bodies(content):
    """Poses of mocap4r2_msgs/RigidBodies."""
    return _make_poses(content.header, [(b.rigid_body_name, b.pose) for b in content.rigidbodies])


def read_named_poses(content):
    """Poses of motion_capture_tracking_interfaces/NamedPoseArray."""
    return _make_poses(content.header, [(b.name, b.pose) for b in content.poses])


def _make_poses(header, pose_by_body):
    t = stamp_ns_or_none(header)
    return [
        MocapPose(header.frame_id, body, t, *to_xyz_and_quat(pose.position, pose.orientation))
        for body, pose in pose_by_body
    ]
