"""vicon_receiver's own message: without a header in most versions, millimetres, 32-bit floats."""

from calib.mocap.messages.body_pose import MocapPose, stamp_ns_or_none

LOCAL_PARENT = "its parent segment"  # of a pose whose translation_type is Local


def read_vicon_position(content):
    """The pose of a Position: body subject/segment."""
    m = content
    header = getattr(m, "header", None)
    parent = LOCAL_PARENT if m.translation_type.lower() == "local" else ""
    body = f"{m.subject_name}/{m.segment_name}"
    xyz, quat = (m.x_trans, m.y_trans, m.z_trans), (m.x_rot, m.y_rot, m.z_rot, m.w)
    return [
        MocapPose(parent, body, header and stamp_ns_or_none(header), xyz, quat, is_multi_body=False)
    ]
