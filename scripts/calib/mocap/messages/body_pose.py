"""One pose of one body, as motion capture says it."""

from typing import NamedTuple

from calib.geometry.units import NS_PER_S


class MocapPose(NamedTuple):
    """T_parent_body: xyz and quat (xyzw) as the message says them, in its unit.

    t: stamp, ns, None where there is none. parent "" is the map, body "" is named by the topic.
    several: whether the message may name more bodies than one.
    """

    parent: str
    body: str
    stamp_ns: int | None
    xyz: tuple
    quat: tuple
    is_multi_body: bool = True


def stamp_ns_or_none(header):
    """The stamp of a ROS header, ns; None where it was never set."""
    return header.stamp.sec * NS_PER_S + header.stamp.nanosec or None


def to_xyz_and_quat(position, orientation):
    """xyz and xyzw of a position (or translation) and an orientation (or rotation)."""
    p, q = position, orientation
    return (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
