"""Corrections of T_robot_sensor and of every T_body_target by one kind of change."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.geometry.se3 import pose_to_rpy


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
            yield _describe_change(setup, f"T_robot_sensor of {stated.sensor}", key, change)
    for name, mount in sorted(stated.mounts.items()):
        for change in list_changes(mount):
            setup = replace(stated, mounts=stated.mounts | {name: change.T})
            yield _describe_change(setup, f"T_body_target of {name}", "", change)


def _describe_change(
    setup: StatedSetup, subject: str, key: str, change: PoseChange
) -> ConfigCorrection:
    return ConfigCorrection(
        setup,
        f"{subject} does not agree with what {setup.sensor} saw, but {change.words} does",
        f"Set {key or subject} to {describe_pose(change.T)}.",
    )


def describe_pose(T: np.ndarray) -> str:
    """Return a pose (4, 4) as it is written into a config."""
    xyz = ", ".join(f"{x:.4f}" for x in T[:3, 3] + 0.0)
    rpy = ", ".join(f"{a:.2f}" for a in np.degrees(pose_to_rpy(T)) + 0.0)
    return f"{{xyz_m: [{xyz}], rpy_deg: [{rpy}]}}"
