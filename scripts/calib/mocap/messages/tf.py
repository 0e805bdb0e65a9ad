"""Transforms of tf: every child frame is a body."""

from calib.mocap.messages.body_pose import MocapPose, stamp_ns_or_none, to_xyz_and_quat


def read_tf_message(content):
    """Poses of a TFMessage."""
    return [_make_pose(item, True) for item in content.transforms]


def read_transform_stamped(content):
    """The pose of a TransformStamped."""
    return [_make_pose(content, False)]


def _make_pose(item, is_multi_body):
    values = to_xyz_and_quat(item.transform.translation, item.transform.rotation)
    header = item.header
    return MocapPose(
        header.frame_id, item.child_frame_id, stamp_ns_or_none(header), *values, is_multi_body
    )
