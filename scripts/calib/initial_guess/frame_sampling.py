"""Which frames to look at: one per placement, the most different placements first."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from calib.io.status import MessageError
from calib.views.pose_selection import select_most_different
from calib.views.target_placements import assign_frames_to_placements

MIN_NEW_DISTANCE_M, MIN_NEW_ANGLE_RAD = (
    0.05,
    np.radians(5),
)  # by which a placement that tells something new differs


@dataclass(frozen=True)
class FrameSample:
    """A frame (index) that was taken in a still placement of a target, T_robot_target (4, 4)."""

    frame: int
    target: str
    placement: int
    T_robot_target: np.ndarray


def read_samples(samples, read_frame):
    """(look, what the sensor measured) of the looks whose message can be read, in their order."""
    for look in samples:
        with suppress(MessageError):
            yield look, read_frame(look.frame)


def choose_frame_samples(frames, placements, T_robot_target, target, options):
    """Looks at one target, at most options["max_placements"], the most different first.

    The middle frame of each placement: farthest from the moves, whatever the clocks say.
    """
    placement = assign_frames_to_placements(frames, placements, target)
    rows = np.unique(placement[placement >= 0])
    order = select_most_different(
        T_robot_target[rows], MIN_NEW_DISTANCE_M, MIN_NEW_ANGLE_RAD, options["max_placements"]
    )
    out = []
    for k in rows[order]:
        during = np.flatnonzero(placement == k)
        out.append(FrameSample(int(during[len(during) // 2]), target, int(k), T_robot_target[k]))
    return out
