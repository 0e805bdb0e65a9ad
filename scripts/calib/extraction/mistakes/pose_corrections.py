"""Corrections of T_robot_sensor and of every T_body_target by one kind of change."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.geometry.se3 import pose_to_rpy
from calib.io.config_change import ConfigChange, any_rig_change, target_change


class PoseChange(NamedTuple):
    """A pose (4, 4) that may have been meant, and what it is of the stated one, in words."""

    T: np.ndarray
    words: str


def correct_poses(
    stated: StatedSetup, list_changes: Callable[[np.ndarray], Iterable[PoseChange]]
) -> Iterator[ConfigCorrection]:
    """Yield the setups with one changed pose: of the sensor, or of a target in its body."""
    if stated.T_robot_sensor is not None:
        key = f"sensors.{stated.sensor}.T_robot_sensor"
        for change in list_changes(stated.T_robot_sensor):
            setup = replace(stated, T_robot_sensor=change.T)
            written = any_rig_change(key, written_pose(change.T))
            yield _describe_change(setup, f"T_robot_sensor of {stated.sensor}", change, written)
    for name, mount in sorted(stated.mounts.items()):
        for change in list_changes(mount):
            setup = replace(stated, mounts=stated.mounts | {name: change.T})
            written = target_change(name, "T_body_target", written_pose(change.T))
            yield _describe_change(setup, f"T_body_target of {name}", change, written)


def _describe_change(
    setup: StatedSetup, subject: str, change: PoseChange, written: ConfigChange
) -> ConfigCorrection:
    place = subject if written["key"] == "T_body_target" else written["key"]
    return ConfigCorrection(
        setup,
        f"{subject} does not agree with what {setup.sensor} saw, but {change.words} does",
        f"Set {place} to {describe_pose(change.T)}.",
        written,
    )


def written_pose(T: np.ndarray) -> dict[str, list[float]]:
    """Return a pose (4, 4) as the value of a key of a config."""
    rpy = np.degrees(pose_to_rpy(T))
    return {"xyz_m": np.round(T[:3, 3], 6).tolist(), "rpy_deg": np.round(rpy, 6).tolist()}


def describe_pose(T: np.ndarray) -> str:
    """Return a pose (4, 4) as it is written into a config."""
    xyz = ", ".join(f"{x:.4f}" for x in T[:3, 3] + 0.0)
    rpy = ", ".join(f"{a:.2f}" for a in np.degrees(pose_to_rpy(T)) + 0.0)
    return f"{{xyz_m: [{xyz}], rpy_deg: [{rpy}]}}"
