"""Faults of what is written in the config: functions that change it in place."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from calib.extraction.mistakes.swapped_axes import R_BODY_OPTICAL
from calib.geometry.se3 import (
    invert_pose,
    make_pose,
    pose_from_rpy,
    pose_to_quat,
    pose_to_rpy,
)


@dataclass
class WrittenConfig:
    """The config of a simulated recording: config.yaml, its rig, and its targets by name."""

    pipeline: dict[str, Any]
    rig: dict[str, Any]
    targets: dict[str, dict[str, Any]]


ConfigMistake = Callable[[WrittenConfig], None]


def edit_config(folder: Path, change: ConfigMistake) -> None:
    """Apply a change to the files of a config folder with one rig."""
    (rig_path,) = folder.glob("rigs/*.yaml")
    target_paths = {p.stem: p for p in sorted(folder.glob("targets/*.yaml"))}
    config = WrittenConfig(
        yaml.safe_load((folder / "config.yaml").read_text()),
        yaml.safe_load(rig_path.read_text()),
        {name: yaml.safe_load(p.read_text()) for name, p in target_paths.items()},
    )
    change(config)
    write_yaml(folder / "config.yaml", config.pipeline)
    write_yaml(rig_path, config.rig)
    for name, path in target_paths.items():
        write_yaml(path, config.targets[name])


def write_yaml(path: Path, content: Any) -> None:
    """Write content as YAML."""
    path.write_text(yaml.safe_dump(content, sort_keys=False))


def scale_squares(factor: float) -> ConfigMistake:
    """Return a mistake: the board's squares are stated too large by a factor."""

    def change(config: WrittenConfig) -> None:
        config.targets["board"]["pattern"]["square_m"] *= factor

    return change


def change_radius(by_m: float) -> ConfigMistake:
    """Return a mistake: the cylinder's radius is stated too large."""

    def change(config: WrittenConfig) -> None:
        config.targets["cylinder"]["radius_m"] += by_m

    return change


def scale_focal_length(factor: float) -> ConfigMistake:
    """Return a mistake: the camera's focal length is stated too long by a factor."""

    def change(config: WrittenConfig) -> None:
        params = config.rig["sensors"]["camera"]["params"]
        params[:2] = [factor * f for f in params[:2]]

    return change


def leave_out_distortion(config: WrittenConfig) -> None:
    """State a lens without distortion."""
    config.rig["sensors"]["camera"]["params"][4:] = [0.0] * 4


def halve_lens_resolution(config: WrittenConfig) -> None:
    """State the lens of images of half the size."""
    camera = config.rig["sensors"]["camera"]
    camera["params"][:4] = [p / 2 for p in camera["params"][:4]]


def state_small_noise(sigma_m: float, sigma_deg: float) -> ConfigMistake:
    """Return a mistake: motion capture is stated to be better than it is."""

    def change(config: WrittenConfig) -> None:
        sigma = {"xyz_m": sigma_m, "rpy_deg": sigma_deg}
        config.rig["mocap"] |= {"pose_sigma": sigma, "pose_bias_sigma": dict(sigma)}

    return change


def hide_mount_sigma(config: WrittenConfig) -> None:
    """Leave out that the targets sit elsewhere in their bodies than stated."""
    for target in config.targets.values():
        target.pop("alignment_sigma", None)


def hide_remount(config: WrittenConfig) -> None:
    """Leave out that the robot's markers were re-attached."""
    for session in config.pipeline["sessions"].values():
        session.pop("remounted", None)


def exchange_rows_and_columns(config: WrittenConfig) -> None:
    """Exchange rows and columns of the checkerboard."""
    config.targets["board"]["pattern"]["inner_corners"].reverse()


def invert_sensor_pose(sensor: str) -> ConfigMistake:
    """Return a mistake: a sensor's pose is written the wrong way round."""
    return _change_pose(sensor, invert_pose)


def exchange_axes(sensor: str) -> ConfigMistake:
    """Return a mistake: a sensor's pose is written in optical axes for body axes."""
    return _change_pose(sensor, lambda T: T @ make_pose(R_BODY_OPTICAL.T))


def _change_pose(sensor: str, change_pose: Callable[[np.ndarray], np.ndarray]) -> ConfigMistake:
    def change(config: WrittenConfig) -> None:
        T = change_pose(read_sensor_pose(config, sensor))
        config.rig["sensors"][sensor]["T_robot_sensor"] = {
            "xyz_m": T[:3, 3].tolist(),
            "rpy_deg": np.rad2deg(pose_to_rpy(T)).tolist(),
        }

    return change


def reorder_pose_quaternion(sensor: str) -> ConfigMistake:
    """Return a mistake: the quaternion of a sensor's pose is written with w first."""

    def change(config: WrittenConfig) -> None:
        T = read_sensor_pose(config, sensor)
        config.rig["sensors"][sensor]["T_robot_sensor"] = {
            "xyz_m": T[:3, 3].tolist(),
            "quat_xyzw": np.roll(pose_to_quat(T), 1).tolist(),
        }

    return change


def read_sensor_pose(config: WrittenConfig, sensor: str) -> np.ndarray:
    """Return the stated pose (4, 4) of a sensor."""
    pose = config.rig["sensors"][sensor]["T_robot_sensor"]
    return pose_from_rpy(np.array(pose["xyz_m"]), np.deg2rad(pose["rpy_deg"]))
