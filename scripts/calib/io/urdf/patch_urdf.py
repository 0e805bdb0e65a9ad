"""Write the calibrated poses of sensors into the user's URDF, in place and with a backup."""

import os
import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from calib.io.atomic_files import atomic_write, require_no_link, require_no_link_above
from calib.io.status import InputError
from calib.io.urdf.sensor_joints import MountedSensor, SensorJoints, compute_joint_origins
from calib.io.urdf.urdf_file import read_urdf_joints, replace_joint_origins, urdf_backup_path

MAX_READ_BACK_ERROR = 1e-12  # of any element of a pose (4, 4)


def patch_urdf(path: Path, sensors: Iterable[MountedSensor], parent_frame: str) -> SensorJoints:
    """Place the sensors in the URDF at a path; returns the joints that hold them.

    The file as it was before the first calibration is kept as a backup beside it. The file is
    replaced in one step, after the new bytes have been read back. Raises InputError if no sensor
    can be placed in it, or if the path is a symbolic link.
    """
    require_no_link(path)
    require_no_link_above(path)
    path = path.resolve()
    data = path.read_bytes()
    joints = read_urdf_joints(data, path)
    result = compute_joint_origins(joints, sensors, parent_frame)
    if result.unplaced and not result.origins:
        reasons = "; ".join(f"{name}: {s}" for name, s in sorted(result.unplaced.items()))
        raise InputError(f"{path.name}: no sensor can be placed in it: {reasons}")
    changed = replace_joint_origins(data, joints, result.origins)
    _check_joint_origins(changed, path, result.origins)
    if changed != data:
        backup = urdf_backup_path(path)
        if not backup.exists():
            replace_file(backup, data, permissions_from=path)
        replace_file(path, changed, permissions_from=path)
    return result


def _check_joint_origins(data: bytes, path: Path, origins: dict[str, np.ndarray]) -> None:
    """Raise InputError if the bytes of a URDF do not hold the origins {child link: (4, 4)}."""
    for joint in read_urdf_joints(data, path):
        if joint.child not in origins:
            continue
        T = joint.T_parent_child
        if T is None or np.abs(T - origins[joint.child]).max() > MAX_READ_BACK_ERROR:
            raise InputError(
                f"{path}: the pose of joint {joint.name} reads back different; the file is "
                "unchanged. State the joint's origin with plain xyz and rpy"
            )


def replace_file(path: Path, data: bytes, permissions_from: Path) -> None:
    """Write a file in one step, through to the disk, with the permissions of another file."""
    with atomic_write(path) as part:
        with part.open("wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        shutil.copymode(permissions_from, part)
