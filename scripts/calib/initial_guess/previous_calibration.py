"""Read initial guesses from a file that robots load: a URDF, or an earlier calibration.json."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calib.io.pose_block import pose_from_config, pose_json
from calib.io.status import InputError
from calib.io.urdf.urdf_file import fixed_joint_transforms, read_urdf_joints, urdf_backup_path

POSE_KEYS = ("xyz_m", "quat_xyzw")


def read_previous_calibration(path: str | Path, config: Mapping[str, Any]) -> dict[str, Any]:
    """Read the file of `guess_from`; config: the rig.

    Returns {sensor: {source, T_robot_sensor}} of a calibration.json, or {sensor: {source, static}}
    of a URDF: its fixed joints like the static transforms of log.json. Poses are JSON.

    Raises InputError if the file is neither, or does not belong to this rig.
    """
    path = Path(path)
    read = _read_calibration_poses if path.suffix == ".json" else _read_urdf_transforms
    return read(path, config)


def _read_calibration_poses(path: Path, config: Mapping[str, Any]) -> dict[str, Any]:
    if path.resolve().is_relative_to(Path("results").resolve()):
        raise InputError(
            f"guess_from: {path} is a result of this pipeline, so every run would change its own "
            "initial guess. Copy the file out of results/."
        )
    try:
        sensors = json.loads(path.read_text())["sensors"]
        blocks = {n: s["T_robot_sensor"] for n, s in sensors.items() if s["T_robot_sensor"]}
        poses = {n: pose_from_config({k: T[k] for k in POSE_KEYS}) for n, T in blocks.items()}
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise InputError(
            f"guess_from: {path} is not a calibration.json: {error!r}. Set guess_from to the "
            "calibration.json of an earlier run, or to a URDF."
        ) from None
    names = sorted(set(poses) & set(config["sensors"]))
    if not names:
        raise InputError(
            f"guess_from: {path} has no pose of a sensor of this rig; found "
            f"{', '.join(sorted(poses)) or 'no pose'}, expected one of "
            f"{', '.join(sorted(config['sensors']))}"
        )
    return {n: {"source": path.name, "T_robot_sensor": pose_json(poses[n])} for n in names}


def _read_urdf_transforms(path: Path, config: Mapping[str, Any]) -> dict[str, Any]:
    transforms = _read_original_joints(path)
    links = {link for edge in transforms for link in edge}
    parent, body = config["export"].get("parent", {}), config["body"]
    has_parent = "T_parent_robot" in parent
    if has_parent:
        transforms[parent["frame"], body] = pose_from_config(parent["T_parent_robot"])
    if not links & {body, parent["frame"] if has_parent else body}:
        raise InputError(
            f"guess_from: {path} has no link {body} on a fixed joint; found "
            f"{', '.join(sorted(links)) or 'no link'}. Set export.parent in the rig: `frame`, a "
            "link of this URDF, and T_parent_robot."
        )
    static = [
        {"parent": a, "child": b, "T": {k: pose_json(T)[k] for k in POSE_KEYS}}
        for (a, b), T in sorted(transforms.items())
    ]
    return {n: {"source": path.name, "static": static} for n in sorted(config["sensors"])}


def _read_original_joints(path: Path) -> dict[tuple[str, str], np.ndarray]:
    """Return the transforms of fixed joints before a calibration was written into the URDF.

    An initial guess that depends on the result would run everything again each time.
    """
    transforms = fixed_joint_transforms(read_urdf_joints(path.read_bytes(), path))
    backup = urdf_backup_path(path)
    if backup.is_file():
        original = fixed_joint_transforms(read_urdf_joints(backup.read_bytes(), backup))
        transforms |= {edge: T for edge, T in original.items() if edge in transforms}
    return transforms
