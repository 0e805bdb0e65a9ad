"""Select the frames of a sensor that show a target standing still."""

from typing import Any

import numpy as np

from calib.targets.target_shapes import TargetShape
from calib.views.field_of_view import PosedSensor
from calib.views.placement_selection import NOT_NEW, select_placements
from calib.views.pose_selection import select_new_poses, space_evenly

# Placements in view that crop keeps, in units of max_placements: some may turn out to be out of
# view at the pose that extract finds.
SPARE_PLACEMENT_FACTOR = 1.5


def select_crop_placements(
    sensor: PosedSensor,
    target: TargetShape,
    placement_by_frame: np.ndarray,
    T_robot_target: np.ndarray,
    options: dict[str, Any],
) -> dict[int, str]:
    """Return the reason against each placement with a new pose, "" for those that crop keeps.

    The most different come first. Parameters: as of select_frames.
    """
    numbers = np.unique(placement_by_frame[placement_by_frame >= 0])
    return select_placements(
        sensor,
        target,
        T_robot_target,
        select_new_poses(T_robot_target, numbers, options),
        options,
        n_max=round(SPARE_PLACEMENT_FACTOR * options["max_placements"]),
    )


def select_frames(
    sensor: PosedSensor,
    target: TargetShape,
    placement_by_frame: np.ndarray,
    T_robot_target: np.ndarray,
    options: dict[str, Any],
) -> np.ndarray:
    """Return the reason (n,) against each frame for one target; "" for the frames to read.

    placement_by_frame: (n,) placement of each frame or -1 (assign_frames_to_placements).
    T_robot_target: (k, 4, 4) of every placement. options: block `crop`.

    More placements are kept than wanted, because extract selects again at the pose it finds.
    """
    reason = np.full(len(placement_by_frame), "not still", dtype=object)
    reason[placement_by_frame >= 0] = NOT_NEW
    against = select_crop_placements(sensor, target, placement_by_frame, T_robot_target, options)
    for number, reason_against in against.items():
        frames = np.flatnonzero(placement_by_frame == number)
        reason[frames] = reason_against or "enough frames of this placement"
        if not reason_against:
            reason[frames[space_evenly(len(frames), options["max_frames"])]] = ""
    return reason
