"""Several named bodies in one message, under one header."""

from calib.mocap.messages.body_pose import Pose, parts, stamp_ns


def rigid_bodies(content):
    """Poses of mocap4r2_msgs/RigidBodies."""
    return _poses(content.header, [(b.rigid_body_name, b.pose) for b in content.rigidbodies])


def named_poses(content):
    """Poses of motion_capture_tracking_interfaces/NamedPoseArray."""
    return _poses(content.header, [(b.name, b.pose) for b in content.poses])


def _poses(header, named):
    t = stamp_ns(header)
    return [
        Pose(header.frame_id, body, t, *parts(pose.position, pose.orientation))
        for body, pose in named
    ]
