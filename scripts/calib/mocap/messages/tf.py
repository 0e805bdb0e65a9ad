"""Transforms of tf: every child frame is a body."""

from calib.mocap.messages.body_pose import Pose, parts, stamp_ns


def message(content):
    """Poses of a TFMessage."""
    return [_pose(item, True) for item in content.transforms]


def one(content):
    """The pose of a TransformStamped."""
    return [_pose(content, False)]


def _pose(item, several):
    values = parts(item.transform.translation, item.transform.rotation)
    header = item.header
    return Pose(header.frame_id, item.child_frame_id, stamp_ns(header), *values, several)
