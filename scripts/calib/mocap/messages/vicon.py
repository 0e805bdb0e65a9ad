"""Position message of vicon_receiver: no header in most versions, millimetres, 32-bit floats."""

from typing import Any

from calib.io.logs.message_headers import header_stamp_ns
from calib.mocap.messages.body_pose import MocapPose

LOCAL_PARENT = "parent_segment"  # of a pose whose translation_type is Local


def read_vicon_position(content: Any) -> list[MocapPose]:
    """Return the pose of a Position; the body is subject/segment."""
    header = getattr(content, "header", None)
    pose = MocapPose(
        parent=LOCAL_PARENT if content.translation_type.lower() == "local" else "",
        body=f"{content.subject_name}/{content.segment_name}",
        stamp_ns=(header_stamp_ns(header) or None) if header else None,
        xyz=(content.x_trans, content.y_trans, content.z_trans),
        quat=(content.x_rot, content.y_rot, content.z_rot, content.w),
        is_multi_body=False,
    )
    return [pose]
