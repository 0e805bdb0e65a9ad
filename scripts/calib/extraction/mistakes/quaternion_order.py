"""Quaternions in the order w, x, y, z: of a pose in the config, or of the motion capture."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from calib.extraction.mistakes.pose_corrections import PoseChange, correct_poses
from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.geometry.se3 import pose_from_xyz_quat, pose_to_quat
from calib.io.config_change import any_rig_change


def correct_quaternion_order(stated: StatedSetup) -> Iterator[ConfigCorrection]:
    """Yield the setups with quaternions read in the other order (see Mistake)."""
    yield from correct_poses(stated, list_orders)
    if stated.other_quaternions:
        yield ConfigCorrection(
            replace(stated, T_robot_body=stated.other_quaternions),
            f"what {stated.sensor} saw agrees with the motion capture only if its quaternions are "
            f"read as {', '.join(stated.other_order)}",
            f"Set mocap.quaternions of the rig to {stated.other_order}.",
            any_rig_change("mocap.quaternions", stated.other_order),
        )


def list_orders(T: np.ndarray) -> Iterable[PoseChange]:
    """Yield a pose (4, 4) with its quaternion in the other order, both ways, and conjugated."""
    quat = pose_to_quat(T)
    for shift in (-1, 1):
        for sign in (1, -1):  # w, or the scalar part, may have lost its sign
            rolled = np.roll(quat * [1, 1, 1, sign], shift)
            words = "the same with its quaternion read as w, x, y, z"
            yield PoseChange(pose_from_xyz_quat(T[:3, 3], rolled), words)
