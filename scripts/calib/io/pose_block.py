"""Poses and their σ as config files and calibration.json write them, to and from SI arrays."""

import numpy as np

from calib.geometry.se3 import pose_from_rpy, pose_from_xyz_quat, pose_to_quat
from calib.io.status import InputError

ROTATION_ROUNDING = 0.02  # what rounding to two decimals does to a rotation that is typed in


def pose_from_config(block):
    """T (4, 4) of a pose block: matrix, or xyz_m with rpy_deg or quat_xyzw.

    Raises InputError where that is no rigid motion; rounding is made good.
    """
    if "matrix" in block:
        return _nearest_rigid_pose(np.asarray(block["matrix"], float))
    if "quat_xyzw" in block:
        norm = np.linalg.norm(block["quat_xyzw"])
        if not abs(norm - 1) < ROTATION_ROUNDING:
            raise InputError(f"quat_xyzw has norm {norm:.4g}, expected 1; write x, y, z, w")
        return pose_from_xyz_quat(block["xyz_m"], block["quat_xyzw"])
    return pose_from_rpy(block["xyz_m"], np.radians(block["rpy_deg"]))


def _nearest_rigid_pose(T):
    """T (4, 4) with the rotation nearest to its own."""
    R = T[:3, :3]
    off = np.abs(R.T @ R - np.eye(3)).max()
    if not (
        off < ROTATION_ROUNDING
        and np.linalg.det(R) > 0
        and np.abs(T[3] - [0, 0, 0, 1]).max() < 1e-6
    ):
        raise InputError(
            f"matrix is no rigid motion: determinant {np.linalg.det(R):.4g}, expected 1; its "
            f"axes are off by {off:.2g} from unit and square, its last row is {T[3].tolist()}; "
            "write rows, m, or give xyz_m with quat_xyzw"
        )
    return pose_from_xyz_quat(T[:3, 3], pose_to_quat(T))


def pose_sigma_from_config(config):
    """(6,) standard deviations of a twist, m and rad, of a block {xyz_m, rpy_deg}."""
    return np.repeat([config["xyz_m"], np.radians(config["rpy_deg"])], 3)


def pose_json(T):
    """{xyz_m, quat_xyzw, matrix} of T (4, 4), as calibration.json states poses."""
    return {
        "xyz_m": T[:3, 3].tolist(),
        "quat_xyzw": pose_to_quat(T).tolist(),
        "matrix": T.tolist(),
    }
