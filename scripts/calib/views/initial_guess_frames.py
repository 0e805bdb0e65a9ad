"""Choose the frames that a search reads: one per placement, the most different placements first."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.io.status import MessageError
from calib.views.pose_selection import select_most_different
from calib.views.sensor_croppers import FrameReader
from calib.views.target_placements import Columns, assign_frames_to_placements

# Smallest difference to other placements at which a placement adds information.
MIN_NEW_DISTANCE_M = 0.05
MIN_NEW_ANGLE_RAD = np.radians(5)


@dataclass(frozen=True)
class FrameSample:
    """A frame (row) that was taken in a still placement of a target, at T_robot_target (4, 4)."""

    frame: int
    target: str
    placement: int
    T_robot_target: np.ndarray


def read_samples(
    samples: Iterable[FrameSample], read_frame: FrameReader
) -> Iterator[tuple[FrameSample, Any]]:
    """Yield the samples whose message can be read, with what the sensor measured, in order."""
    for sample in samples:
        with suppress(MessageError):
            yield sample, read_frame(sample.frame)


def choose_frame_samples(
    frames: Columns,
    placements: Columns,
    T_robot_target: np.ndarray,
    target: str,
    options: dict[str, Any],
) -> list[FrameSample]:
    """Return the samples of one target, at most options["max_placements"], most different first.

    frames: with `mocap_time_ns`. T_robot_target: (n, 4, 4) of every placement. The middle frame of
    each placement is taken: it is farthest from any motion, even if the clocks differ.
    """
    placement_by_frame = assign_frames_to_placements(frames, placements, target)
    rows = np.unique(placement_by_frame[placement_by_frame >= 0])
    order = select_most_different(
        T_robot_target[rows], MIN_NEW_DISTANCE_M, MIN_NEW_ANGLE_RAD, options["max_placements"]
    )
    samples = []
    for k in rows[order]:
        inside = np.flatnonzero(placement_by_frame == k)
        middle = int(inside[len(inside) // 2])
        samples.append(FrameSample(middle, target, int(k), T_robot_target[k]))
    return samples
