"""Messages of tf: every child frame is a body."""

from typing import Any

from calib.mocap.messages.body_pose import MocapPose, make_mocap_pose


def read_tf_message(content: Any) -> list[MocapPose]:
    """Return the poses of a TFMessage."""
    return [_make_pose(item, is_multi_body=True) for item in content.transforms]


def read_transform_stamped(content: Any) -> list[MocapPose]:
    """Return the pose of a TransformStamped."""
    return [_make_pose(content, is_multi_body=False)]


def _make_pose(item: Any, is_multi_body: bool) -> MocapPose:
    return make_mocap_pose(
        item.header,
        item.child_frame_id,
        position=item.transform.translation,
        orientation=item.transform.rotation,
        is_multi_body=is_multi_body,
    )
