"""Build the scene that the export formats write, from calibration.json and the config."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from calib.export.calibrated_scene import ExportScene, ExportSensor, ExportSession
from calib.geometry.se3 import invert_pose
from calib.io.pose_block import pose_from_config
from calib.io.safe_names import safe_name
from calib.io.status import InputError, escape_control_characters
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.sensor_models import camera_from_config

OPTICAL_SUFFIXES = ("_optical_frame", "_optical")


def build_export_scene(
    calibration: dict[str, Any],
    options: dict[str, Any],
    sessions: dict[str, ExportSession] | None = None,
) -> ExportScene:
    """Build the scene of a calibration.json; options is the slice of the config.

    Raises InputError if the parent frame is that of a sensor without a pose.
    """
    results, targets = calibration["sensors"], options.get("targets", {})
    poses = _collect_sensor_poses(results)
    frames, notes = assign_frame_names({name: results[name]["frame"] for name in poses})
    parent, T_parent_robot = resolve_parent_frame(options, poses, frames)
    notes += rename_parent_duplicates(parent, frames, options)
    return ExportScene(
        rig=safe_name(calibration["rig"]),
        parent_frame=parent,
        T_parent_robot=T_parent_robot,
        robot_body=strip_leading_slash(options["body"]),
        sensors={
            name: ExportSensor(
                name=name,
                kind=results[name]["kind"],
                topic=options["sensors"][name]["topic"],
                frame=frames[name],
                T_parent_sensor=T_parent_robot @ T_robot_sensor,
                camera=build_export_camera(options["sensors"][name], results[name]),
                body_frame=find_body_frame(name, frames, parent, options),
            )
            for name, T_robot_sensor in poses.items()
        },
        sessions=sessions or {},
        targets=targets,
        T_body_target=collect_target_mounts(calibration, targets),
        missing_sensor_reasons=_collect_missing_reasons(results, poses),
        notes=tuple(notes),
        max_views=options["export"]["max_views"],
        verdict=calibration["verdict"],
        reasons=tuple(map(_format_one_line, calibration["reasons"])),
    )


def _collect_sensor_poses(results: dict[str, Any]) -> dict[str, np.ndarray]:
    """Collect T_robot_sensor (4, 4) of the sensors that have one, by name."""
    return {
        name: np.array(result["T_robot_sensor"]["matrix"])
        for name, result in sorted(results.items())
        if result["T_robot_sensor"] is not None
    }


def _collect_missing_reasons(
    results: dict[str, Any], poses: dict[str, np.ndarray]
) -> dict[str, str]:
    """Collect why sensors have no pose, by name."""
    return {
        name: _format_one_line(result["status"]["reason"])
        for name, result in results.items()
        if name not in poses
    }


def _format_one_line(text: str) -> str:
    """Return a text as one line that every format can hold in a comment."""
    return escape_control_characters(" ".join(text.split()))


def strip_leading_slash(frame: str) -> str:
    """Return the name of a frame as tf2 takes it; results in a folder may be a stranger's."""
    return safe_name(frame.lstrip("/"))


def assign_frame_names(message_frames: dict[str, str]) -> tuple[dict[str, str], list[str]]:
    """Choose the frame name of every sensor; returns ({sensor: frame}, notes on other names).

    A sensor takes the frame of its messages, or its own name if that is empty or not unique.
    """
    stripped = {name: strip_leading_slash(frame) for name, frame in message_frames.items()}
    count = Counter(stripped.values())
    frames, notes = {}, []
    for name, frame in stripped.items():
        if frame and count[frame] == 1:
            frames[name] = frame
            continue
        frames[name] = f"{name}_sensor" if name in count else name
        reason = f"{count[frame]} sensors use {frame}" if frame else "its messages have no frame_id"
        notes.append(_describe_new_name(name, frames[name], reason))
    return frames, notes


def rename_parent_duplicates(
    parent: str, frames: dict[str, str], options: dict[str, Any]
) -> list[str]:
    """Rename, in place, frames that have the parent's name but are not the parent.

    Returns notes on the new names.
    """
    choice = options["export"]["parent"]
    parent_sensor = (
        choice.get("sensor") if isinstance(choice, dict) and "frame" not in choice else None
    )
    notes = []
    for name, frame in frames.items():
        if frame == parent and name != parent_sensor:
            frames[name] = f"{name}_sensor" if name == parent else name
            notes.append(_describe_new_name(name, frames[name], f"{frame} is the parent frame"))
    return notes


def _describe_new_name(sensor: str, frame: str, reason: str) -> str:
    return f"the frame of {sensor} is exported as {frame}: {reason}"


def resolve_parent_frame(
    options: dict[str, Any], poses: dict[str, np.ndarray], frames: dict[str, str]
) -> tuple[str, np.ndarray]:
    """Return the name and T_parent_robot (4, 4) of the frame that `export.parent` chooses.

    poses: T_robot_sensor (4, 4) by sensor. Raises InputError if it is a sensor without a pose.
    """
    choice = options["export"]["parent"]
    if isinstance(choice, str):
        return strip_leading_slash(choice or options["body"]), np.eye(4)
    if "sensor" not in choice:
        return strip_leading_slash(choice["frame"]), pose_from_config(choice["T_parent_robot"])
    name = choice["sensor"]
    if name not in poses:
        raise InputError(
            f"export.parent: sensor {name} has no pose in this calibration; choose one of "
            f"{', '.join(poses) or 'none'}"
        )
    T_parent_sensor = (
        pose_from_config(choice["T_parent_sensor"]) if "T_parent_sensor" in choice else np.eye(4)
    )
    frame = strip_leading_slash(choice.get("frame", frames[name]))
    return frame, T_parent_sensor @ invert_pose(poses[name])


def build_export_camera(
    config: dict[str, Any], sensor_result: dict[str, Any]
) -> CameraModel | None:
    """Build a camera's model with the estimated parameters, else those of the config.

    Returns None for a lidar or where neither is known.
    """
    if config["kind"] != "camera" or "params" not in config:
        return None
    params = (sensor_result["intrinsics"] or config)["params"]
    return camera_from_config(config | {"params": params})


def find_body_frame(name: str, frames: dict[str, str], parent: str, options: dict[str, Any]) -> str:
    """Return the frame of a camera's body, "" for none or for a lidar.

    `export.body_frames` states it; else a camera in …_optical_frame has the body …_link, unless
    that name is taken.
    """
    if options["sensors"][name]["kind"] != "camera":
        return ""
    stated = options["export"]["body_frames"].get(name)
    if stated is not None:
        return strip_leading_slash(stated)
    frame = frames[name]
    suffix = next((s for s in OPTICAL_SUFFIXES if frame.endswith(s)), None)
    if suffix is None or frame == parent:
        return ""
    link = frame.removesuffix(suffix) + "_link"
    return "" if link in (parent, *frames.values()) else link


def collect_target_mounts(
    calibration: dict[str, Any], targets: dict[str, dict[str, Any]]
) -> dict[str, np.ndarray]:
    """Collect T_body_target (4, 4) by target, estimated or as configured, where it is known."""
    mounts = {}
    for name, config in targets.items():
        estimate = calibration["targets"].get(name)
        if estimate:
            mounts[name] = np.array(estimate["T_body_target"]["matrix"])
        elif "mount" not in config:
            mounts[name] = pose_from_config(config["T_body_target"])
    return mounts


def build_export_session(
    name: str,
    *,
    start_ns: int,
    calibration: dict[str, Any],
    placements: dict[str, np.ndarray],
    view_paths: dict[str, Path],
) -> ExportSession:
    """Build one recording; the pose of the robot's MCS body is estimated if it was remounted."""
    remounted = calibration["sessions"].get(name)
    T_robot_body = np.array(remounted["T_robot_markers"]["matrix"]) if remounted else np.eye(4)
    return ExportSession(
        name=name,
        start_ns=start_ns,
        T_robot_body=T_robot_body,
        placements=placements,
        view_paths={sensor: Path(path) for sensor, path in view_paths.items()},
    )
