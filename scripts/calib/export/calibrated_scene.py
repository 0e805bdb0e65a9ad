"""What every format is given: the calibrated sensors in the parent frame that the user chose.

Names of frames are those that ROS can hold: without a leading slash, one for each sensor; a sensor
whose messages name none, or one that is taken, goes by its own name.
"""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calib.geometry import se3
from calib.io import pose_block
from calib.io.status import InputError
from calib.sensors import sensor_models
from calib.sensors.camera.camera_model import Camera

# REP 103: x forward, y left, z up of a camera's body from x right, y down, z forward of its image.
T_BODY_OPTICAL = se3.pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
OPTICAL = ("_optical_frame", "_optical")


@dataclass(frozen=True)
class Sensor:
    """One sensor: T_parent_sensor (4, 4), the frame of its messages; of a camera its model, or None
    where it is not known, and the frame of its body, "" for none."""

    name: str
    kind: str
    topic: str
    frame: str
    T: np.ndarray
    camera: Camera | None = None
    body: str = ""


@dataclass(frozen=True)
class Edge:
    """A static transform: T_parent_child (4, 4)."""

    parent: str
    child: str
    T: np.ndarray
    sensor: str


@dataclass(frozen=True)
class Session:
    """One recording: time of its first message, ns, T_robot_body (4, 4) of the robot's MCS body,
    its placements (columns), and views.parquet of its sensors by name."""

    name: str
    start: int
    T_robot_body: np.ndarray
    placements: dict
    views: dict


@dataclass(frozen=True)
class Scene:
    """All of a rig: name of the parent frame, T_parent_robot (4, 4), name of the robot's MCS body,
    sensors and sessions by name; the targets' slices of the config with T_body_target (4, 4)
    beside them; why sensors are left out, by name; what a user should know, in lines."""

    rig: str
    parent: str
    T_parent_robot: np.ndarray
    body: str
    sensors: dict
    sessions: dict = field(default_factory=dict)
    targets: dict = field(default_factory=dict)
    T_body_target: dict = field(default_factory=dict)
    left_out: dict = field(default_factory=dict)
    notes: tuple = ()
    most_views: int = 0

    @property
    def cameras(self):
        """The cameras by name."""
        return {n: s for n, s in self.sensors.items() if s.kind == "camera"}

    @property
    def lidars(self):
        """The lidars by name."""
        return {n: s for n, s in self.sensors.items() if s.kind == "lidar"}

    def edges(self):
        """The tree of frames from the parent to every sensor, by way of cameras' bodies."""
        out = []
        for s in self.sensors.values():
            if s.frame == self.parent:
                continue
            if s.body:
                T = s.T @ se3.inverse(T_BODY_OPTICAL)
                out.append(Edge(self.parent, s.body, T, s.name))
                out.append(Edge(s.body, s.frame, T_BODY_OPTICAL, s.name))
            else:
                out.append(Edge(self.parent, s.frame, s.T, s.name))
        return out

    def worked(self):
        """One worked point for every sensor, and why others are missing, in lines."""
        lines = [f"{s.name}: {worked_point(s.frame, self.parent, s.T)}" for s in
                 self.sensors.values()]  # fmt: skip
        return lines + [f"{n} is left out: {why}" for n, why in sorted(self.left_out.items())]


def worked_point(frame, parent, T, p=(1.0, 0.0, 0.0)):
    """A point of one frame and the same point in its parent frame, in words."""
    here = ", ".join(f"{v:g}" for v in p)
    there = ", ".join(f"{v:.6f}" for v in se3.transform(T, np.array(p)) + 0.0)
    return f"the point ({here}) of {frame} is ({there}) in {parent}"


def worked_pixel(sensor, p=(0.1, 0.2, 1.0)):
    """A point of a camera's frame and its pixel, in words."""
    uv, seen = sensor.camera.project(p)
    here = ", ".join(f"{v:g}" for v in p)
    pixel = (
        f"at pixel ({uv[0, 0]:.4f}, {uv[0, 1]:.4f})" if seen[0] else "outside what the lens sees"
    )
    return f"the point ({here}) of {sensor.frame} is {pixel}"


def comment(lines):
    """Lines as a comment, each on a line of its own whatever a name holds."""
    return "".join(f"# {' '.join(line.split())}\n" for line in lines)


def scene(calibration, options, sessions=None):
    """The Scene of a calibration.json. options: the slice of the config.

    Raises InputError where the parent frame is that of a sensor without a pose.
    """
    found = calibration["sensors"]
    poses = {
        n: np.array(s["T_robot_sensor"]["matrix"])
        for n, s in sorted(found.items())
        if s["T_robot_sensor"] is not None
    }
    frames, notes = frames_of({n: found[n]["frame"] for n in poses})
    parent, T_parent_robot = parent_of(options, poses, frames)
    notes += apart_from(parent, frames, options)
    sensors = {
        n: Sensor(
            name=n,
            kind=found[n]["kind"],
            topic=options["sensors"][n]["topic"],
            frame=frames[n],
            T=T_parent_robot @ T,
            camera=camera(options["sensors"][n], found[n]),
            body=body(n, frames, parent, options) if found[n]["kind"] == "camera" else "",
        )
        for n, T in poses.items()
    }
    return Scene(
        rig=calibration["rig"],
        parent=parent,
        T_parent_robot=T_parent_robot,
        body=plain(options["body"]),
        sensors=sensors,
        sessions=sessions or {},
        targets=options.get("targets", {}),
        T_body_target=mounts(calibration, options.get("targets", {})),
        left_out={n: s["status"]["reason"] for n, s in found.items() if n not in poses},
        notes=tuple(notes),
        most_views=options["export"]["max_views"],
    )


def plain(frame):
    """A frame's name as tf2 takes it."""
    return frame.lstrip("/")


def frames_of(said):
    """({sensor: frame}, notes): what the messages said, or the sensor's name where that will not
    do."""
    said = {n: plain(frame) for n, frame in said.items()}
    count, out, notes = Counter(said.values()), {}, []
    for name, frame in said.items():
        if frame and count[frame] == 1:
            out[name] = frame
            continue
        out[name] = f"{name}_sensor" if name in count else name
        why = f"{count[frame]} sensors have {frame}" if frame else "its messages name none"
        notes.append(f"the frame of {name} goes by {out[name]}: {why}")
    return out, notes


def apart_from(parent, frames, options):
    """Notes on sensors whose frame bears the parent's name and is not it; renames them."""
    chosen = options["export"]["parent"]
    own = chosen.get("sensor") if isinstance(chosen, dict) else None
    notes = []
    for name, frame in frames.items():
        if frame == parent and not (name == own and "frame" not in chosen):
            frames[name] = f"{name}_sensor" if name == parent else name
            notes.append(f"the frame of {name} goes by {frames[name]}: {frame} is the parent")
    return notes


def parent_of(options, poses, frames):
    """(name, T_parent_robot) of the parent frame that `export.parent` chooses."""
    chosen = options["export"]["parent"]
    if isinstance(chosen, str):
        return plain(chosen or options["body"]), np.eye(4)
    if "sensor" not in chosen:
        return plain(chosen["frame"]), pose_block.pose(chosen["T_parent_robot"])
    name = chosen["sensor"]
    if name not in poses:
        raise InputError(
            f"export.parent: {name} has no pose in this calibration; choose one of "
            f"{', '.join(poses) or 'none'}"
        )
    T = pose_block.pose(chosen["T_parent_sensor"]) if "T_parent_sensor" in chosen else np.eye(4)
    return plain(chosen.get("frame", frames[name])), T @ se3.inverse(poses[name])


def camera(config, found):
    """The Camera with the parameters that were estimated, else those configured; None for none."""
    if config["kind"] != "camera" or "params" not in config:
        return None
    params = (found["intrinsics"] or config)["params"]
    return sensor_models.camera(config | {"params": params})


def body(name, frames, parent, options):
    """The frame of a camera's body: as `export.body_frames` says, else, for a frame named
    …_optical_frame, …_link; "" where that name is taken."""
    said = options["export"]["body_frames"].get(name)
    if said is not None:
        return plain(said)
    frame = frames[name]
    suffix = next((s for s in OPTICAL if frame.endswith(s)), None)
    if suffix is None or frame == parent:
        return ""
    link = frame.removesuffix(suffix) + "_link"
    return "" if link in (parent, *frames.values()) else link


def mounts(calibration, targets):
    """{target: T_body_target (4, 4)}, as estimated or as configured; without those unknown."""
    out = {}
    for name, config in targets.items():
        estimate = calibration["targets"].get(name)
        if estimate:
            out[name] = np.array(estimate["T_body_target"]["matrix"])
        elif "mount" not in config:
            out[name] = pose_block.pose(config["T_body_target"])
    return out


def session(name, start, calibration, placements, views):
    """The Session of a recording; views: {sensor: path of views.parquet}."""
    anew = calibration["sessions"].get(name)
    T = np.array(anew["T_robot_markers"]["matrix"]) if anew else np.eye(4)
    return Session(name, start, T, placements, {n: Path(p) for n, p in views.items()})
