"""Poses and their σ as config files and calibration.json write them, to and from SI arrays."""

import numpy as np

from calib.geometry import se3
from calib.io.status import InputError

TYPED = 0.02  # what rounding to two decimals does to a rotation that is typed in


def pose(config):
    """T (4, 4) of a pose block: matrix, or xyz_m with rpy_deg or quat_xyzw.

    Raises InputError where that is no rigid motion; rounding is made good.
    """
    if "matrix" in config:
        return _rigid(np.asarray(config["matrix"], float))
    if "quat_xyzw" in config:
        norm = np.linalg.norm(config["quat_xyzw"])
        if not abs(norm - 1) < TYPED:
            raise InputError(f"quat_xyzw has norm {norm:.4g}, expected 1; write x, y, z, w")
        return se3.from_xyz_quat(config["xyz_m"], config["quat_xyzw"])
    return se3.from_rpy(config["xyz_m"], np.radians(config["rpy_deg"]))


def _rigid(T):
    """T (4, 4) with the rotation nearest to its own."""
    R = T[:3, :3]
    off = np.abs(R.T @ R - np.eye(3)).max()
    if not (off < TYPED and np.linalg.det(R) > 0 and np.abs(T[3] - [0, 0, 0, 1]).max() < 1e-6):
        raise InputError(
            f"matrix is no rigid motion: determinant {np.linalg.det(R):.4g}, expected 1; its "
            f"axes are off by {off:.2g} from unit and square, its last row is {T[3].tolist()}; "
            "write rows, m, or give xyz_m with quat_xyzw"
        )
    return se3.from_xyz_quat(T[:3, 3], se3.to_quat(T))


def pose_sigma(config):
    """(6,) standard deviations of a twist, m and rad, of a block {xyz_m, rpy_deg}."""
    return np.repeat([config["xyz_m"], np.radians(config["rpy_deg"])], 3)


def pose_json(T):
    """{xyz_m, quat_xyzw, matrix} of T (4, 4), as calibration.json states poses."""
    return {
        "xyz_m": T[:3, 3].tolist(),
        "quat_xyzw": se3.to_quat(T).tolist(),
        "matrix": T.tolist(),
    }
