"""A transform that is written the wrong way round, or only its rotation is."""

from collections.abc import Iterable, Iterator

import numpy as np

from calib.extraction.mistakes.pose_corrections import PoseChange, correct_poses
from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.geometry.se3 import invert_pose, make_pose


def correct_inverted_poses(stated: StatedSetup) -> Iterable[ConfigCorrection]:
    """Yield the setups with one pose inverted (see Mistake)."""
    return correct_poses(stated, list_inverses)


def list_inverses(T: np.ndarray) -> Iterator[PoseChange]:
    """Yield the inverse of a pose (4, 4), and the pose with its rotation inverted."""
    yield PoseChange(invert_pose(T), "its inverse")
    R, t = T[:3, :3], T[:3, 3]
    yield PoseChange(make_pose(R.T, t), "the same position with the inverse rotation")
    yield PoseChange(make_pose(R, -R.T @ t), "the same rotation with the position of the inverse")
