"""What a sensor may see of the targets in a recording, as far as log and motion capture tell it."""

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from calib.initial_guess.pose_guess import PoseGuess
from calib.initial_guess.stated_pose import read_pose_guess
from calib.io.parquet_tables import select_rows
from calib.io.status import Status, failure_status
from calib.mocap.body_trajectory import target_trajectories, trajectory_from_columns
from calib.sensors.sensor_models import with_log_metadata
from calib.targets.target_shapes import target_from_config
from calib.views.field_of_view import PosedSensor
from calib.views.frame_selection import select_frames
from calib.views.moving_view_selection import select_moving_views
from calib.views.placement_selection import visibility_status
from calib.views.sensor_reader import make_cropper
from calib.views.target_placements import (
    PlacementTable,
    assign_frames_to_placements,
    compute_target_poses,
    find_still_rows,
    mounts_from_guess,
    trim_placement_ends,
    with_mocap_time,
)

NO_FRAME_REASON = "no message of the sensor while it is still"


@dataclass(frozen=True)
class PreflightSession:
    """One recording after decode and gate: its audit, columns of frames and of poses, and its
    placements; has_remounted_markers: whether the robot's markers were re-attached before it."""

    audit: dict
    frames: dict
    poses: dict
    placements: PlacementTable
    has_remounted_markers: bool
    sensor_names: tuple


@dataclass(frozen=True)
class TargetVisibility:
    """One target before one sensor: its shape, T_robot_target (n, 4, 4) of every placement, and the
    reason (n,) against each, "" for those in view: from where the rig says that the sensor sits,
    and from anywhere within the uncertainty of that. in_motion: views of it that tell the clock;
    stated: whether it is known where both sit, without which all is taken to be in view."""

    shape: object
    T_robot_target: np.ndarray
    expected_reasons: tuple
    possible_reasons: tuple
    n_moving_views: int
    has_known_pose: bool

    def count_lost_placements(self):
        """{reason: placements} of those that are out of view for certain."""
        return dict(Counter(why for why in self.possible_reasons if why).most_common())


@dataclass(frozen=True)
class SensorVisibility:
    """One sensor in one session: kind, where its pose is stated ("none" if nowhere), the share of
    its messages for which the robot's pose is known, what it may see of each target, and whether
    views in motion can tell its clock."""

    kind: str
    status: Status
    pose_source: str = "none"
    mocap_coverage: float = 0.0
    visibility_by_target: dict = field(default_factory=dict)
    has_measurement_time: bool = False


# A sensor whose pose is not stated: all targets may be in its view.
UNKNOWN_POSE = PosedSensor(
    model=None,
    check_visibility=lambda model, target, T_sensor_target, margin, options, /: "",
    T_robot_sensor=np.eye(4),
    margin=np.zeros(6),
)


def assess_sensor_visibility(session, name, options):
    """The Look of a sensor of a Session; options: of scripts/preflight.py."""
    block, audit = options["sensors"][name], session.audit["sensors"][name]
    status = Status.from_dict(audit["status"])
    source, found = (
        read_pose_guess(name, block, options, session.audit) if status.ok else ("none", PoseGuess())
    )
    status = status if not status.ok else found.status
    if not status.ok:
        return SensorVisibility(block["kind"], status)
    frames = select_rows(session.frames, session.frames["sensor"] == name)
    frames = with_mocap_time(frames, block["time_offset_s"])
    robot = trajectory_from_columns(session.poses, options["body"], options["max_gap_s"])
    known = float(robot.poses_at(frames["mocap_time_ns"])[1].mean())
    status = session.placements.still_target_status()
    status = _no_mocap_status(name) if status.ok and not known else status
    if not status.ok:
        return SensorVisibility(block["kind"], status, source, known)
    sensor, eye = make_cropper(with_log_metadata(block, audit)), UNKNOWN_POSE
    if session.has_remounted_markers or found.T_robot_sensor is None:
        source = "none"
    else:
        margin = options["crop"]["margin_sigma"] * np.asarray(found.sigma)
        eye = PosedSensor(sensor.model, sensor.check_visibility, found.T_robot_sensor, margin)
    seen = _assess_targets(session, eye, frames, block, options, sensor.has_measurement_time)
    reasons = [why for s in seen.values() for why in s.possible_reasons]
    status = visibility_status(name, reasons)
    return SensorVisibility(block["kind"], status, source, known, seen, sensor.has_measurement_time)


def _no_mocap_status(name):
    return failure_status(
        f"no message of {name} falls into a time at which the motion capture knows the robot",
        "0 %",
        "most of them",
        "Record both at once into one log, and see whether the motion capture lost the robot.",
    )


def _assess_targets(session, assumed_pose, frames, block, options, has_measurement_time):
    """{target: Seen} of one sensor in a session; block: of the sensor; has_measurement_time: whether its views of
    what moves tell a time."""
    blocks = {n: options["targets"][n] for n in sorted(session.placements.target_status)}
    mounts = mounts_from_guess(blocks, {"mounts": {}})
    placements = trim_placement_ends(session.placements.columns, block["time_offset_sigma_s"])
    T_robot_target = compute_target_poses(placements, mounts)
    bodies = {n: b["body"] for n, b in blocks.items()}
    paths = target_trajectories(session.poses, options["body"], bodies, options["max_gap_s"])
    out = {}
    for name, config in blocks.items():
        # Where a target sits in its body may be unknown as well.
        by, shape = assumed_pose if name in mounts else UNKNOWN_POSE, target_from_config(config)
        rows = find_still_rows(placements, name)
        during = assign_frames_to_placements(frames, placements, name)
        expected, possible = (
            _reasons_by_placement(rows, during, sensor, shape, T_robot_target, options["crop"])
            for sensor in (replace(by, margin=np.zeros(6)), by)
        )
        moving = 0
        if has_measurement_time and shape.uses_exact_surface:
            moving = _count_moving_views(
                by, shape, paths[name], frames, mounts.get(name), block, options
            )
        out[name] = TargetVisibility(
            shape, T_robot_target[rows], expected, possible, moving, by is not UNKNOWN_POSE
        )
    return out


def _reasons_by_placement(rows, placement_by_frame, sensor, shape, T_robot_target, options):
    """The reason against each placement of the rows (n,), as a tuple; "" for those that crop would
    read. placement_by_frame: placement of each frame, or -1."""
    why = select_frames(sensor, shape, placement_by_frame, T_robot_target, options)
    of = {k: set(why[placement_by_frame == k]) for k in rows}
    return tuple(NO_FRAME_REASON if not of[k] else "" if "" in of[k] else min(of[k]) for k in rows)


def _count_moving_views(sensor, shape, trajectory, frames, T_body_target, block, options):
    """How many views of a target in motion crop would read."""
    views = select_moving_views(
        sensor,
        shape,
        trajectory,
        np.eye(4) if T_body_target is None else T_body_target,
        frames["stamp_ns"],
        time_offset={"value": block["time_offset_s"], "sigma": block["time_offset_sigma_s"]},
        options=options["crop"],
    )
    return len(views)
