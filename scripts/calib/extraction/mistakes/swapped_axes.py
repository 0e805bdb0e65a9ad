"""Axes that are exchanged: optical for body axes (REP 103), a turned board, another robot frame."""

from collections.abc import Iterable, Iterator
from itertools import permutations, product

import numpy as np

from calib.extraction.mistakes.pose_corrections import PoseChange, correct_poses
from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.geometry.se3 import make_pose

# Optical axes (x right, y down, z forward) in a body's (x forward, y left, z up).
R_BODY_OPTICAL = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
OPTICAL_WORDS = "the same in optical axes (x right, y down, z forward, REP 103)"
BODY_WORDS = "the same in body axes (x forward, y left, z up, REP 103)"


def correct_swapped_axes(stated: StatedSetup) -> Iterable[ConfigCorrection]:
    """Yield the setups with the axes of one frame exchanged (see Mistake)."""
    return correct_poses(stated, list_axis_swaps)


def list_axis_swaps(T: np.ndarray) -> Iterator[PoseChange]:
    """Yield a pose (4, 4) with its own axes exchanged, then with those of its parent."""
    yield PoseChange(T @ make_pose(R_BODY_OPTICAL), OPTICAL_WORDS)
    yield PoseChange(T @ make_pose(R_BODY_OPTICAL.T), BODY_WORDS)
    for R in axis_rotations():
        yield PoseChange(T @ make_pose(R), f"the same turned {_describe_turn(R)} of its own")
    for R in axis_rotations():
        yield PoseChange(make_pose(R) @ T, f"the same turned {_describe_turn(R)} of its parent")


def axis_rotations() -> list[np.ndarray]:
    """Return the 23 rotations (3, 3) that exchange axes, the smallest first."""
    out = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        R = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(R) > 0 and np.trace(R) < 2.5:
            out.append(R)
    return sorted(out, key=lambda R: -np.trace(R))


def _describe_turn(R: np.ndarray) -> str:
    """Return a rotation as `by 90 deg about the z axis`; the axes that follow if it has others."""
    angle = round(np.degrees(np.arccos((np.trace(R) - 1) / 2)))
    axis = np.linalg.svd(R - np.eye(3))[2][2]
    vee = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    axis = axis if axis @ vee >= 0 else -axis
    components = np.round(axis / np.abs(axis).max()).astype(int)
    if np.count_nonzero(components) == 1:
        k = int(np.flatnonzero(components)[0])
        sign = "-" if components[k] < 0 and angle < 180 else ""
        return f"by {sign}{angle} deg about the {'xyz'[k]} axis"
    return f"by {angle} deg about the axis ({', '.join(map(str, components))})"
