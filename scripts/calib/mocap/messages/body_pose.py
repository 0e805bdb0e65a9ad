"""One pose of one body, as a message of motion capture states it."""

from typing import Any, NamedTuple

from calib.io.logs.message_headers import header_stamp_ns


class MocapPose(NamedTuple):
    """T_parent_body as in the message: xyz in its unit, quat in its order.

    parent: "" is the map; body: "" is named by the topic; stamp_ns: None if it was never set;
    is_multi_body: whether messages of this type may name several bodies.
    """

    parent: str
    body: str
    stamp_ns: int | None
    xyz: tuple[float, ...]
    quat: tuple[float, ...]
    is_multi_body: bool = True


def make_mocap_pose(
    header: Any, body: str, *, position: Any, orientation: Any, is_multi_body: bool = True
) -> MocapPose:
    """Return the pose of a std_msgs/Header, a Point or Vector3, and a Quaternion."""
    return MocapPose(
        parent=header.frame_id,
        body=body,
        stamp_ns=header_stamp_ns(header) or None,
        xyz=(position.x, position.y, position.z),
        quat=(orientation.x, orientation.y, orientation.z, orientation.w),
        is_multi_body=is_multi_body,
    )
