"""One pose of one body, as motion capture says it."""

from typing import NamedTuple

NS = 1_000_000_000


class Pose(NamedTuple):
    """T_parent_body: xyz and quat (xyzw) as the message says them, in its unit.

    t: stamp, ns, None where there is none. parent "" is the map, body "" is named by the topic.
    several: whether the message may name more bodies than one.
    """

    parent: str
    body: str
    t: int | None
    xyz: tuple
    quat: tuple
    several: bool = True


def stamp_ns(header):
    """The stamp of a ROS header, ns; None where it was never set."""
    return header.stamp.sec * NS + header.stamp.nanosec or None


def parts(position, orientation):
    """xyz and xyzw of a position (or translation) and an orientation (or rotation)."""
    p, q = position, orientation
    return (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
