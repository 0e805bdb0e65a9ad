"""Poses and their σ in config files and calibration.json, to and from arrays in SI units."""

from typing import Any

import numpy as np

from calib.geometry.se3 import pose_from_rpy, pose_from_xyz_quat, pose_to_quat
from calib.io.status import InputError

MAX_ROTATION_ROUNDING = 0.02  # error of a rotation whose entries were rounded to two decimals


def pose_from_config(block: dict[str, Any]) -> np.ndarray:
    """Return T (4, 4) of a pose block: `matrix`, or `xyz_m` with `rpy_deg` or `quat_xyzw`.

    Rounding errors of typed numbers are removed. Raises InputError for anything else that is no
    rigid motion.
    """
    if "matrix" in block:
        return _nearest_rigid_pose(np.asarray(block["matrix"], float))
    if "quat_xyzw" in block:
        norm = np.linalg.norm(block["quat_xyzw"])
        if not abs(norm - 1) < MAX_ROTATION_ROUNDING:
            raise InputError(
                f"quat_xyzw has norm {norm:.4g}, expected 1. Write the quaternion as x, y, z, w."
            )
        return pose_from_xyz_quat(block["xyz_m"], block["quat_xyzw"])
    return pose_from_rpy(block["xyz_m"], np.radians(block["rpy_deg"]))


def _nearest_rigid_pose(T: np.ndarray) -> np.ndarray:
    """Return T (4, 4) with the nearest rotation matrix in place of its own."""
    R = T[:3, :3]
    error = np.abs(R.T @ R - np.eye(3)).max()
    if not (
        error < MAX_ROTATION_ROUNDING
        and np.linalg.det(R) > 0
        and np.abs(T[3] - [0, 0, 0, 1]).max() < 1e-6
    ):
        raise InputError(
            f"matrix is not a rigid motion: determinant {np.linalg.det(R):.4g}, expected 1; error "
            f"of its axes {error:.2g}, expected below {MAX_ROTATION_ROUNDING:g}; last row "
            f"{T[3].tolist()}, expected [0, 0, 0, 1]. Write the matrix by rows, in m, or use xyz_m "
            "with quat_xyzw."
        )
    return pose_from_xyz_quat(T[:3, 3], pose_to_quat(T))


def pose_sigma_from_config(config: dict[str, float]) -> np.ndarray:
    """Return the standard deviations (6,), m and rad, of a block {xyz_m, rpy_deg}."""
    return np.repeat([config["xyz_m"], np.radians(config["rpy_deg"])], 3)


def pose_json(T: np.ndarray) -> dict[str, list[Any]]:
    """Return {xyz_m, quat_xyzw, matrix} of T (4, 4), as in calibration.json."""
    return {
        "xyz_m": T[:3, 3].tolist(),
        "quat_xyzw": pose_to_quat(T).tolist(),
        "matrix": T.tolist(),
    }
