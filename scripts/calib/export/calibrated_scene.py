"""What every format is given: the calibrated sensors in the parent frame that the user chose.

Names of frames are those that ROS can hold: without a leading slash, one for each sensor; a sensor
whose messages name none, or one that is taken, goes by its own name.
"""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calib.geometry.se3 import invert_pose, make_pose, transform_points
from calib.io.pose_block import pose_from_config
from calib.io.status import InputError
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.sensor_models import camera_from_config

# REP 103: x forward, y left, z up of a camera's body from x right, y down, z forward of its image.
T_BODY_OPTICAL = make_pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
OPTICAL_SUFFIXES = ("_optical_frame", "_optical")


@dataclass(frozen=True)
class ExportSensor:
    """One sensor: T_parent_sensor (4, 4), the frame of its messages; of a camera its model, or None
    where it is not known, and the frame of its body, "" for none."""

    name: str
    kind: str
    topic: str
    frame: str
    T_parent_sensor: np.ndarray
    camera: CameraModel | None = None
    body_frame: str = ""


@dataclass(frozen=True)
class StaticTransform:
    """A static transform: T_parent_child (4, 4)."""

    parent: str
    child: str
    T_parent_child: np.ndarray
    sensor: str


@dataclass(frozen=True)
class ExportSession:
    """One recording: time of its first message, ns, T_robot_body (4, 4) of the robot's MCS body,
    its placements (columns), and views.parquet of its sensors by name."""

    name: str
    start_ns: int
    T_robot_body: np.ndarray
    placements: dict
    view_paths: dict


@dataclass(frozen=True)
class ExportScene:
    """All of a rig: name of the parent frame, T_parent_robot (4, 4), name of the robot's MCS body,
    sensors and sessions by name; the targets' slices of the config with T_body_target (4, 4)
    beside them; why sensors are left out, by name; what a user should know, in lines."""

    rig: str
    parent_frame: str
    T_parent_robot: np.ndarray
    robot_body: str
    sensors: dict
    sessions: dict = field(default_factory=dict)
    targets: dict = field(default_factory=dict)
    T_body_target: dict = field(default_factory=dict)
    missing_sensor_reasons: dict = field(default_factory=dict)
    notes: tuple = ()
    max_views: int = 0

    @property
    def cameras(self):
        """The cameras by name."""
        return {n: s for n, s in self.sensors.items() if s.kind == "camera"}

    @property
    def lidars(self):
        """The lidars by name."""
        return {n: s for n, s in self.sensors.items() if s.kind == "lidar"}

    def static_transforms(self):
        """The tree of frames from the parent to every sensor, by way of cameras' bodies."""
        out = []
        for s in self.sensors.values():
            if s.frame == self.parent_frame:
                continue
            if s.body_frame:
                T = s.T_parent_sensor @ invert_pose(T_BODY_OPTICAL)
                out.append(StaticTransform(self.parent_frame, s.body_frame, T, s.name))
                out.append(StaticTransform(s.body_frame, s.frame, T_BODY_OPTICAL, s.name))
            else:
                out.append(StaticTransform(self.parent_frame, s.frame, s.T_parent_sensor, s.name))
        return out

    def describe_worked_points(self):
        """One worked point for every sensor, and why others are missing, in lines."""
        lines = [f"{s.name}: {format_worked_point(s.frame, self.parent_frame, s.T_parent_sensor)}" for s in
                 self.sensors.values()]  # fmt: skip
        return lines + [
            f"{n} is left out: {why}" for n, why in sorted(self.missing_sensor_reasons.items())
        ]


def format_worked_point(frame, parent, T, point=(1.0, 0.0, 0.0)):
    """A point of one frame and the same point in its parent frame, in words."""
    here = ", ".join(f"{v:g}" for v in point)
    there = ", ".join(f"{v:.6f}" for v in transform_points(T, np.array(point)) + 0.0)
    return f"the point ({here}) of {frame} is ({there}) in {parent}"


def format_worked_pixel(sensor, point=(0.1, 0.2, 1.0)):
    """A point of a camera's frame and its pixel, in words."""
    uv, seen = sensor.camera.project(point)
    here = ", ".join(f"{v:g}" for v in point)
    pixel = (
        f"at pixel ({uv[0, 0]:.4f}, {uv[0, 1]:.4f})" if seen[0] else "outside what the lens sees"
    )
    return f"the point ({here}) of {sensor.frame} is {pixel}"


def format_hash_comment(lines):
    """Lines as a comment, each on a line of its own whatever a name holds."""
    return "".join(f"# {' '.join(line.split())}\n" for line in lines)


def build_export_scene(calibration, options, sessions=None):
    """The Scene of a calibration.json. options: the slice of the config.

    Raises InputError where the parent frame is that of a sensor without a pose.
    """
    found = calibration["sensors"]
    poses = {
        n: np.array(s["T_robot_sensor"]["matrix"])
        for n, s in sorted(found.items())
        if s["T_robot_sensor"] is not None
    }
    frames, notes = assign_frame_names({n: found[n]["frame"] for n in poses})
    parent, T_parent_robot = resolve_parent_frame(options, poses, frames)
    notes += rename_parent_duplicates(parent, frames, options)
    sensors = {
        n: ExportSensor(
            name=n,
            kind=found[n]["kind"],
            topic=options["sensors"][n]["topic"],
            frame=frames[n],
            T_parent_sensor=T_parent_robot @ T,
            camera=build_export_camera(options["sensors"][n], found[n]),
            body_frame=find_body_frame(n, frames, parent, options)
            if found[n]["kind"] == "camera"
            else "",
        )
        for n, T in poses.items()
    }
    return ExportScene(
        rig=calibration["rig"],
        parent_frame=parent,
        T_parent_robot=T_parent_robot,
        robot_body=strip_leading_slash(options["body"]),
        sensors=sensors,
        sessions=sessions or {},
        targets=options.get("targets", {}),
        T_body_target=collect_target_mounts(calibration, options.get("targets", {})),
        missing_sensor_reasons={
            n: s["status"]["reason"] for n, s in found.items() if n not in poses
        },
        notes=tuple(notes),
        max_views=options["export"]["max_views"],
    )


def strip_leading_slash(frame):
    """A frame's name as tf2 takes it."""
    return frame.lstrip("/")


def assign_frame_names(message_frames):
    """({sensor: frame}, notes): what the messages said, or the sensor's name where that will not
    do."""
    message_frames = {n: strip_leading_slash(frame) for n, frame in message_frames.items()}
    count, out, notes = Counter(message_frames.values()), {}, []
    for name, frame in message_frames.items():
        if frame and count[frame] == 1:
            out[name] = frame
            continue
        out[name] = f"{name}_sensor" if name in count else name
        why = f"{count[frame]} sensors have {frame}" if frame else "its messages name none"
        notes.append(f"the frame of {name} goes by {out[name]}: {why}")
    return out, notes


def rename_parent_duplicates(parent, frames, options):
    """Notes on sensors whose frame bears the parent's name and is not it; renames them."""
    chosen = options["export"]["parent"]
    own = chosen.get("sensor") if isinstance(chosen, dict) else None
    notes = []
    for name, frame in frames.items():
        if frame == parent and not (name == own and "frame" not in chosen):
            frames[name] = f"{name}_sensor" if name == parent else name
            notes.append(f"the frame of {name} goes by {frames[name]}: {frame} is the parent")
    return notes


def resolve_parent_frame(options, poses, frames):
    """(name, T_parent_robot) of the parent frame that `export.parent` chooses."""
    chosen = options["export"]["parent"]
    if isinstance(chosen, str):
        return strip_leading_slash(chosen or options["body"]), np.eye(4)
    if "sensor" not in chosen:
        return strip_leading_slash(chosen["frame"]), pose_from_config(chosen["T_parent_robot"])
    name = chosen["sensor"]
    if name not in poses:
        raise InputError(
            f"export.parent: {name} has no pose in this calibration; choose one of "
            f"{', '.join(poses) or 'none'}"
        )
    T = pose_from_config(chosen["T_parent_sensor"]) if "T_parent_sensor" in chosen else np.eye(4)
    return strip_leading_slash(chosen.get("frame", frames[name])), T @ invert_pose(poses[name])


def build_export_camera(config, sensor_result):
    """The Camera with the parameters that were estimated, else those configured; None for none."""
    if config["kind"] != "camera" or "params" not in config:
        return None
    params = (sensor_result["intrinsics"] or config)["params"]
    return camera_from_config(config | {"params": params})


def find_body_frame(name, frames, parent, options):
    """The frame of a camera's body: as `export.body_frames` says, else, for a frame named
    …_optical_frame, …_link; "" where that name is taken."""
    said = options["export"]["body_frames"].get(name)
    if said is not None:
        return strip_leading_slash(said)
    frame = frames[name]
    suffix = next((s for s in OPTICAL_SUFFIXES if frame.endswith(s)), None)
    if suffix is None or frame == parent:
        return ""
    link = frame.removesuffix(suffix) + "_link"
    return "" if link in (parent, *frames.values()) else link


def collect_target_mounts(calibration, targets):
    """{target: T_body_target (4, 4)}, as estimated or as configured; without those unknown."""
    out = {}
    for name, config in targets.items():
        estimate = calibration["targets"].get(name)
        if estimate:
            out[name] = np.array(estimate["T_body_target"]["matrix"])
        elif "mount" not in config:
            out[name] = pose_from_config(config["T_body_target"])
    return out


def build_export_session(name, start, calibration, placements, views):
    """The Session of a recording; views: {sensor: path of views.parquet}."""
    anew = calibration["sessions"].get(name)
    T = np.array(anew["T_robot_markers"]["matrix"]) if anew else np.eye(4)
    return ExportSession(name, start, T, placements, {n: Path(p) for n, p in views.items()})
