"""Numbers of a pose with a lost sign, in another order or in another unit."""

from collections.abc import Iterable, Iterator
from itertools import permutations, product

import numpy as np

from calib.extraction.mistakes.pose_corrections import PoseChange, correct_poses
from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.geometry.se3 import pose_from_rpy, pose_to_rpy

ANGLE_NAMES = ("roll", "pitch", "yaw")
LENGTH_FACTORS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}


def correct_lost_signs(stated: StatedSetup) -> Iterable[ConfigCorrection]:
    """Yield the setups with numbers of one pose read otherwise (see Mistake)."""
    return correct_poses(stated, list_readings)


def list_readings(T: np.ndarray) -> Iterator[PoseChange]:
    """Yield a pose (4, 4) with other signs, orders and units of its numbers."""
    xyz, rpy = T[:3, 3], pose_to_rpy(T)
    for signs in list(product((1, -1), repeat=3))[1:]:
        names = _negated("xyz", signs)
        yield PoseChange(pose_from_rpy(xyz * signs, rpy), f"the same with {names} negated")
    for signs in list(product((1, -1), repeat=3))[1:]:
        names = _negated(ANGLE_NAMES, signs)
        yield PoseChange(pose_from_rpy(xyz, rpy * signs), f"the same with {names} negated")
    for order in list(permutations(range(3)))[1:]:
        names = ", ".join("xyz"[k] for k in order)
        words = f"the same with xyz_m read as {names}"
        yield PoseChange(pose_from_rpy(xyz[list(order)], rpy), words)
    for order in list(permutations(range(3)))[1:]:
        names = ", ".join(ANGLE_NAMES[k] for k in order)
        words = f"the same with rpy_deg read as {names}"
        yield PoseChange(pose_from_rpy(xyz, rpy[list(order)]), words)
    in_turn = pose_from_rpy([0, 0, 0], [rpy[0], 0, 0]) @ pose_from_rpy([0, 0, 0], [0, rpy[1], 0])
    moving = pose_from_rpy(xyz, [0, 0, 0]) @ in_turn @ pose_from_rpy([0, 0, 0], [0, 0, rpy[2]])
    yield PoseChange(moving, "the same turned about x first, then the moved y and z")
    radians = pose_from_rpy(xyz, np.degrees(rpy))
    yield PoseChange(radians, "the same with its angles read in radians")
    for unit, factor in LENGTH_FACTORS.items():
        words = f"the same with xyz_m read in {unit}"
        yield PoseChange(pose_from_rpy(factor * xyz, rpy), words)


def _negated(names: Iterable[str], signs: tuple[int, ...]) -> str:
    return " and ".join(n for n, s in zip(names, signs, strict=True) if s < 0)
