"""How much poses rotate, and about which axes."""

import numpy as np

from calib.geometry.se3 import mean_pose


def rotation_spread_deg(T_body: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much poses (n, 4, 4), n ≥ 3, rotate about their mean, and about which axes.

    The rms (3,), deg, largest first, and the axes, rows (3, 3) in the body frame.
    """
    _, xi = mean_pose(T_body)
    _, size, axes = np.linalg.svd(xi[:, 3:], full_matrices=False)
    return np.degrees(size) / np.sqrt(len(xi)), axes
