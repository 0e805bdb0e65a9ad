"""The calibrated rig as every export format sees it: sensors in the user's parent frame.

Frames have names that ROS can hold: no leading slash, one frame per sensor.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calib.geometry.se3 import invert_pose, transform_points
from calib.io.logs.ros_messages import FrameTransform
from calib.io.status import Status, failure_status
from calib.io.urdf.sensor_joints import T_BODY_OPTICAL
from calib.sensors.camera.camera_model import CameraModel

WORKED_POINT = (1.0, 0.0, 0.0)
WORKED_CAMERA_POINT = (0.1, 0.2, 1.0)


@dataclass(frozen=True)
class ExportSensor:
    """One sensor with its pose T_parent_sensor (4, 4) and the frame of its messages.

    camera: model of a camera, None for a lidar or an unknown lens. body_frame: frame of a camera's
    body, "" for none.
    """

    name: str
    kind: str
    topic: str
    frame: str
    T_parent_sensor: np.ndarray
    camera: CameraModel | None = None
    body_frame: str = ""


@dataclass(frozen=True)
class ExportSession:
    """One recording: time of its first message, T_robot_body (4, 4) of the robot's MCS body, the
    columns of placements.parquet, and the paths of views.parquet by sensor."""

    name: str
    start_ns: int
    T_robot_body: np.ndarray
    placements: dict[str, np.ndarray]
    view_paths: dict[str, Path]


@dataclass(frozen=True)
class ExportScene:
    """A calibrated rig: sensors and recordings by name, in the parent frame that the user chose.

    T_parent_robot (4, 4); robot_body: name of the robot's MCS body; targets: their config blocks,
    with T_body_target (4, 4) beside them where it is known; missing_sensor_reasons: why a sensor
    is not among the sensors; notes: lines for the user; max_views: placements per recording that
    the Foxglove format shows; verdict: pass or warn, with its reasons.
    """

    rig: str
    parent_frame: str
    T_parent_robot: np.ndarray
    robot_body: str
    sensors: dict[str, ExportSensor]
    sessions: dict[str, ExportSession] = field(default_factory=dict)
    targets: dict[str, dict[str, Any]] = field(default_factory=dict)
    T_body_target: dict[str, np.ndarray] = field(default_factory=dict)
    missing_sensor_reasons: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    max_views: int = 0
    verdict: str = "pass"
    reasons: tuple[str, ...] = ()

    @property
    def cameras(self) -> dict[str, ExportSensor]:
        """Cameras by name."""
        return {name: s for name, s in self.sensors.items() if s.kind == "camera"}

    @property
    def lidars(self) -> dict[str, ExportSensor]:
        """Lidars by name."""
        return {name: s for name, s in self.sensors.items() if s.kind == "lidar"}

    def static_transforms(self) -> list[FrameTransform]:
        """List the tree of frames from the parent to every sensor, by way of cameras' bodies."""
        transforms = []
        for s in self.sensors.values():
            if s.frame == self.parent_frame:
                continue
            if s.body_frame:
                T_parent_body = s.T_parent_sensor @ invert_pose(T_BODY_OPTICAL)
                transforms.append(FrameTransform(self.parent_frame, s.body_frame, T_parent_body))
                transforms.append(FrameTransform(s.body_frame, s.frame, T_BODY_OPTICAL))
            else:
                transforms.append(FrameTransform(self.parent_frame, s.frame, s.T_parent_sensor))
        return transforms

    def describe_verdict(self) -> list[str]:
        """Return a line per reason of a verdict that is not pass, for the head of each file."""
        if self.verdict == "pass":
            return []
        return [f"{self.verdict.upper()}: {reason}" for reason in self.reasons]

    def describe_worked_points(self) -> list[str]:
        """Describe one point of every sensor in the parent frame, and why sensors are missing."""
        return [
            f"{s.name}: {format_worked_point(s.frame, self.parent_frame, s.T_parent_sensor)}"
            for s in self.sensors.values()
        ] + self.describe_missing_sensors()

    def describe_missing_sensors(self) -> list[str]:
        """Describe why sensors are missing, one line each."""
        return [
            f"{name} is left out: {reason}"
            for name, reason in sorted(self.missing_sensor_reasons.items())
        ]


def lens_or_status(sensor: ExportSensor) -> CameraModel | Status:
    """Return the camera model of a camera, or why there is none."""
    if sensor.camera is not None:
        return sensor.camera
    return failure_status(
        f"{sensor.name} has no lens parameters",
        expected=f"model, params and size_px in the config of {sensor.name}",
        remedy="State them, or set camera_info to the topic that has them.",
    )


def format_worked_point(frame: str, parent: str, T_parent_frame: np.ndarray) -> str:
    """Describe one point of a frame and the same point in its parent frame."""
    point = ", ".join(f"{v:g}" for v in WORKED_POINT)
    xyz = transform_points(T_parent_frame, np.array(WORKED_POINT)) + 0.0  # no -0
    return f"the point ({point}) of {frame} is ({', '.join(f'{v:.6f}' for v in xyz)}) in {parent}"


def format_worked_pixel(frame: str, camera: CameraModel) -> str:
    """Describe one point of a camera's frame and its pixel."""
    uv, is_valid = camera.project(np.array(WORKED_CAMERA_POINT))
    point = ", ".join(f"{v:g}" for v in WORKED_CAMERA_POINT)
    if not is_valid[0]:
        return f"the point ({point}) of {frame} is outside what the lens sees"
    return f"the point ({point}) of {frame} is at pixel ({uv[0, 0]:.4f}, {uv[0, 1]:.4f})"


def format_hash_comment(lines: Iterable[str]) -> str:
    """Format lines as comments that begin with #; a name with a line break cannot end one."""
    return "".join(f"# {' '.join(line.split())}\n" for line in lines)
