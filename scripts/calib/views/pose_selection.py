"""Choose the most different poses, and evenly spread items."""

from typing import Any

import numpy as np

from calib.geometry.se3 import invert_pose, rotation_angle


def select_new_poses(poses: np.ndarray, numbers: np.ndarray, options: dict[str, Any]) -> np.ndarray:
    """Return those of the placements `numbers` (k,) whose pose is new, the most different first.

    poses: T_robot_target (n, 4, 4) of all placements. They are in the robot frame, so the choice
    does not depend on the initial guess of a sensor. options: block `crop`.
    """
    numbers = np.asarray(numbers, int)
    chosen = select_most_different(
        poses[numbers],
        min_distance=options["min_distance_m"],
        min_angle=np.radians(options["min_angle_deg"]),
        n_max=len(numbers),
    )
    return numbers[chosen]


def select_most_different(
    poses: np.ndarray, min_distance: float, min_angle: float, n_max: int
) -> np.ndarray:
    """Return the indices of at most n_max poses (n, 4, 4), each different from all others chosen.

    Farthest first: the next pose is the one whose nearest chosen pose is farthest, with distances
    in units of min_distance, m, and min_angle, rad. Ties go to the earlier pose. It ends when all
    other poses are nearer than one unit to a chosen one.
    """
    if len(poses) == 0:
        return np.zeros(0, int)
    chosen: list[int] = []
    nearest = np.full(len(poses), np.inf)
    while len(chosen) < n_max and nearest.max() >= 1:
        chosen.append(int(nearest.argmax()))
        relative = invert_pose(poses[chosen[-1]]) @ poses
        shift = np.linalg.norm(poses[:, :3, 3] - poses[chosen[-1], :3, 3], axis=1)
        # With a threshold of zero every pose is new.
        distance = np.maximum(
            shift / max(min_distance, 1e-9), rotation_angle(relative) / max(min_angle, 1e-9)
        )
        nearest = np.minimum(nearest, distance)
        nearest[chosen] = -1
    return np.array(chosen)


def space_evenly(n: int, n_max: int) -> np.ndarray:
    """Return at most n_max of the indices 0 .. n-1, evenly spread, including both ends."""
    if n <= n_max:
        return np.arange(n)
    return np.unique(np.round(np.linspace(0, n - 1, n_max)).astype(int))
