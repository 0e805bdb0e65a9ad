"""What a sensor may see of the targets in a recording, as far as log and motion capture tell it."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from calib.initial_guess.pose_guess import Found
from calib.initial_guess.stated_pose import stated
from calib.io import parquet_tables
from calib.io.status import Status, failed
from calib.mocap import body_trajectory
from calib.sensors import sensor_models
from calib.targets import target_shapes
from calib.views import frame_selection, moving_view_selection, sensor_reader

NO_FRAME = "no message of the sensor while it is still"


@dataclass(frozen=True)
class Session:
    """One recording after decode and gate: its audit, columns of frames, of poses and of
    placements, the status of these and of each target's; remounted: whether the robot's markers sit
    elsewhere than the rig's poses mean; streams: names of its sensors."""

    audit: dict
    frames: dict
    poses: dict
    placements: dict
    status: Status
    targets: dict
    remounted: bool
    streams: tuple


@dataclass(frozen=True)
class Seen:
    """One target before one sensor: its shape, T_robot_target (n, 4, 4) of every placement, and the
    reason (n,) against each, "" for those in view: from where the rig says that the sensor sits,
    and from anywhere within the uncertainty of that. in_motion: views of it that tell the clock;
    stated: whether it is known where both sit, without which all is taken to be in view."""

    shape: object
    T: np.ndarray
    expected: tuple
    possible: tuple
    in_motion: int
    stated: bool

    def lost(self):
        """{reason: placements} of those that are out of view for certain."""
        return dict(Counter(why for why in self.possible if why).most_common())


@dataclass(frozen=True)
class Look:
    """One sensor in one session: kind, where its pose is stated ("none" if nowhere), the share of
    its messages for which the robot's pose is known, what it may see of each target, and whether
    views in motion can tell its clock."""

    kind: str
    status: Status
    source: str = "none"
    known: float = 0.0
    seen: dict = field(default_factory=dict)
    timed: bool = False


class Anything:
    """In place of a sensor of which nobody has said where it sits: it may see whatever is there."""

    model = None

    @staticmethod
    def hidden(*where):
        return ""


@dataclass(frozen=True)
class Eye:
    """A sensor (of cropping.KINDS, or Anything), T_robot_sensor (4, 4) as stated, and by how much
    that may be wrong (6,)."""

    sensor: object
    T: np.ndarray
    margin: np.ndarray


BLIND = Eye(Anything, np.eye(4), np.zeros(6))


def look(session, name, options):
    """The Look of a sensor of a Session; options: of scripts/preflight.py."""
    block, audit = options["sensors"][name], session.audit["sensors"][name]
    status = Status.from_dict(audit["status"])
    source, found = stated(name, block, options, session.audit) if status.ok else ("none", Found())
    status = status if not status.ok else found.status
    if not status.ok:
        return Look(block["kind"], status)
    frames = parquet_tables.select(session.frames, session.frames["sensor"] == name)
    frames = frame_selection.timed(frames, block["time_offset_s"])
    robot = body_trajectory.trajectory(session.poses, options["body"], options["max_gap_s"])
    known = float(robot.at(frames["seen"])[1].mean())
    status = _placed(session)
    status = _never(name) if status.ok and not known else status
    if not status.ok:
        return Look(block["kind"], status, source, known)
    sensor, eye = sensor_reader.KINDS[block["kind"]](sensor_models.heard(block, audit)), BLIND
    if session.remounted or found.T_robot_sensor is None:
        source = "none"
    else:
        margin = options["crop"]["margin_sigma"] * np.asarray(found.sigma)
        eye = Eye(sensor, found.T_robot_sensor, margin)
    seen = _targets(session, eye, frames, block, options, sensor.timed)
    reasons = [why for s in seen.values() for why in s.possible]
    status = frame_selection.seen(name, reasons)
    return Look(block["kind"], status, source, known, seen, sensor.timed)


def _placed(session):
    """Ok, or why no target is ever still."""
    held = [status for _, status in sorted(session.targets.items())]
    return session.status if not session.status.ok or any(s.ok for s in held) else held[0]


def _never(name):
    return failed(
        f"no message of {name} falls into a time at which the motion capture knows the robot",
        "0 %",
        "most of them",
        "Record both at once into one log, and see whether the motion capture lost the robot.",
    )


def _targets(session, eye, frames, block, options, timed):
    """{target: Seen} of one sensor in a session; block: of the sensor; timed: whether its views of
    what moves tell a time."""
    blocks = {n: options["targets"][n] for n in sorted(session.targets)}
    mounts = frame_selection.mounts(blocks, {"mounts": {}})
    placements = frame_selection.trimmed(session.placements, block["time_offset_sigma_s"])
    T_robot_target = frame_selection.placed(placements, mounts)
    bodies = {n: b["body"] for n, b in blocks.items()}
    paths = body_trajectory.trajectories(
        session.poses, options["body"], bodies, options["max_gap_s"]
    )
    out = {}
    for name, config in blocks.items():
        # Where a target sits in its body may be unknown as well.
        by, shape = eye if name in mounts else BLIND, target_shapes.from_config(config)
        rows = np.flatnonzero((placements["target"] == name) & (placements["kind"] == "still"))
        during = frame_selection.considered(frames, placements, name)
        expected, possible = (
            _reasons(rows, during, by, shape, T_robot_target, margin, options["crop"])
            for margin in (np.zeros(6), by.margin)
        )
        moving = 0
        if timed and config["method"] == "surface":
            moving = _in_motion(by, shape, paths[name], frames, mounts.get(name), block, options)
        out[name] = Seen(shape, T_robot_target[rows], expected, possible, moving, by is not BLIND)
    return out


def _reasons(rows, during, eye, shape, T_robot_target, margin, options):
    """The reason against each placement of the rows (n,), as a tuple; "" for those that crop would
    read. during: placement of each frame, or -1."""
    where = T_robot_target, eye.T, margin
    why = frame_selection.choose(eye.sensor, shape, during, *where, options)
    of = {k: set(why[during == k]) for k in rows}
    return tuple(NO_FRAME if not of[k] else "" if "" in of[k] else min(of[k]) for k in rows)


def _in_motion(eye, shape, path, frames, T_body_target, block, options):
    """How many views of a target in motion crop would read."""
    offset = {"value": block["time_offset_s"], "sigma": block["time_offset_sigma_s"]}
    guess = {"T_robot_sensor": {"matrix": eye.T}, "time_offset_s": offset}
    mount = np.eye(4) if T_body_target is None else T_body_target
    where = path, frames["t"], mount, guess, eye.margin
    return len(moving_view_selection.choose(eye.sensor, shape, *where, options["crop"]))
