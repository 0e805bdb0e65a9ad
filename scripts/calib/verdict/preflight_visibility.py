"""What a sensor may see of the targets in a recording, before any payload is read."""

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib.initial_guess.initial_guess import NO_SOURCE, PoseGuess
from calib.initial_guess.stated_pose import read_stated_pose
from calib.io.parquet_tables import select_rows
from calib.io.status import Status, failure_status
from calib.mocap.body_trajectory import Trajectory, target_trajectories, trajectory_from_columns
from calib.sensors.sensor_models import with_log_metadata
from calib.targets.target_shapes import TargetShape, target_from_config
from calib.views.field_of_view import PosedSensor
from calib.views.frame_selection import select_frames
from calib.views.moving_view_selection import select_moving_views
from calib.views.placement_selection import visibility_status
from calib.views.sensor_croppers import make_cropper
from calib.views.target_placements import (
    Columns,
    PlacementTable,
    assign_frames_to_placements,
    compute_target_poses,
    find_still_rows,
    mounts_from_guess,
    trim_placement_ends,
    with_mocap_time,
)

NO_FRAME_REASON = "no message of the sensor during the placement"


@dataclass(frozen=True)
class PreflightSession:
    """One recording after decode and gate.

    audit: log.json. frames, poses: columns of frames.parquet and mocap.parquet.
    has_remounted_markers: the robot's markers were re-attached before it. streams: its sensors.
    """

    audit: dict[str, Any]
    frames: Columns
    poses: Columns
    placements: PlacementTable
    has_remounted_markers: bool
    streams: tuple[str, ...]

    @property
    def mocap_notes(self) -> tuple[str, ...]:
        """Return the notes on the noise of motion capture at rest."""
        return self.placements.mocap_notes


@dataclass(frozen=True)
class TargetVisibility:
    """What one sensor may see of one target.

    T_robot_target: (n, 4, 4) of every placement. expected_reasons, possible_reasons: (n,) why a
    placement is not in view from the stated sensor pose, and from every pose within its
    uncertainty; "" if it is. n_moving_views: views in motion that constrain the time offset.
    has_known_pose: whether the poses of sensor and target are stated. If not, all is in view.
    """

    shape: TargetShape
    T_robot_target: np.ndarray
    expected_reasons: tuple[str, ...]
    possible_reasons: tuple[str, ...]
    n_moving_views: int
    has_known_pose: bool

    def count_lost_placements(self) -> dict[str, int]:
        """Return {reason: placements} of those that are certainly not in view."""
        return dict(Counter(reason for reason in self.possible_reasons if reason).most_common())


@dataclass(frozen=True)
class SensorVisibility:
    """One sensor in one session.

    pose_source: where its pose is stated, "none" if nowhere. mocap_coverage: share of its messages
    for which the robot's pose is known. has_measurement_time: whether moving views can constrain
    its time offset.
    """

    kind: str
    status: Status
    pose_source: str = "none"
    mocap_coverage: float = 0.0
    visibility_by_target: dict[str, TargetVisibility] = field(default_factory=dict)
    has_measurement_time: bool = False

    @property
    def n_moving_views(self) -> int:
        """Number of views of moving targets."""
        return sum(t.n_moving_views for t in self.visibility_by_target.values())


# A sensor whose pose is not stated: all targets may be in its view.
UNKNOWN_POSE = PosedSensor(
    model=None,
    check_visibility=lambda model, target, T_sensor_target, margin, options, /: "",
    T_robot_sensor=np.eye(4),
    margin=np.zeros(6),
)


def assess_sensor_visibility(
    session: PreflightSession, name: str, options: dict[str, Any]
) -> SensorVisibility:
    """Return what a sensor may see in a session. options: of scripts/preflight.py."""
    block, audit = options["sensors"][name], session.audit["sensors"][name]
    status, guess = Status.from_dict(audit["status"]), PoseGuess()
    if status.ok:
        guess = read_stated_pose(name, block, options, session.audit)
        status = guess.status
    source = guess.source
    if not status.ok:
        return SensorVisibility(block["kind"], status)
    frames = select_rows(session.frames, session.frames["sensor"] == name)
    frames = with_mocap_time(frames, block["time_offset_s"])
    coverage = _mocap_coverage(session, frames, options)
    status = session.placements.still_target_status()
    if status.ok and not coverage:
        status = _no_mocap_status(name)
    if not status.ok:
        return SensorVisibility(block["kind"], status, source, coverage)
    cropper = make_cropper(with_log_metadata(block, audit))
    if session.has_remounted_markers or guess.value is None:
        source, posed = NO_SOURCE, UNKNOWN_POSE
    else:
        margin = options["crop"]["margin_sigma"] * np.asarray(guess.sigma)
        posed = PosedSensor(cropper.model, cropper.check_visibility, guess.value, margin)
    has_times = cropper.has_measurement_time
    targets = _assess_targets(
        session, posed, frames, block=block, options=options, counts_moving_views=has_times
    )
    reasons = [reason for t in targets.values() for reason in t.possible_reasons]
    status = visibility_status(name, reasons)
    return SensorVisibility(block["kind"], status, source, coverage, targets, has_times)


def _mocap_coverage(session: PreflightSession, frames: Columns, options: dict[str, Any]) -> float:
    """Return the share of the frames for which the robot's pose is known."""
    robot = trajectory_from_columns(session.poses, options["body"], options["max_gap_s"])
    return float(robot.poses_at(frames["mocap_time_ns"])[1].mean())


def _no_mocap_status(name: str) -> Status:
    return failure_status(
        f"no message of {name} has a time at which the motion capture knows the robot's pose",
        "0 %",
        "most of them",
        "Record motion capture and sensors at the same time into one log, and check whether the "
        "motion capture lost the robot.",
    )


def _assess_targets(
    session: PreflightSession,
    posed: PosedSensor,
    frames: Columns,
    *,
    block: dict[str, Any],
    options: dict[str, Any],
    counts_moving_views: bool,
) -> dict[str, TargetVisibility]:
    """Return what a sensor may see of each target. frames: of the sensor. block: its config."""
    configs = {n: options["targets"][n] for n in sorted(session.placements.target_status)}
    mounts = mounts_from_guess(configs, {"mounts": {}})
    placements = trim_placement_ends(session.placements.columns, block["time_offset_sigma_s"])
    T_robot_target = compute_target_poses(placements, mounts)
    bodies = {n: config["body"] for n, config in configs.items()}
    trajectories = target_trajectories(session.poses, options["body"], bodies, options["max_gap_s"])
    out = {}
    for name, config in configs.items():
        # The mount of a target may be unknown, too.
        sensor = posed if name in mounts else UNKNOWN_POSE
        still = _assess_still_target(
            sensor,
            target_from_config(config),
            find_still_rows(placements, name),
            assign_frames_to_placements(frames, placements, name),
            T_robot_target=T_robot_target,
            options=options["crop"],
        )
        n_moving_views = 0
        if counts_moving_views and still.shape.uses_exact_surface:
            n_moving_views = _count_moving_views(
                sensor,
                still.shape,
                trajectories[name],
                mounts.get(name),
                frames,
                block=block,
                options=options["crop"],
            )
        out[name] = replace(still, n_moving_views=n_moving_views)
    return out


def _assess_still_target(
    sensor: PosedSensor,
    shape: TargetShape,
    rows: np.ndarray,
    placement_by_frame: np.ndarray,
    *,
    T_robot_target: np.ndarray,
    options: dict[str, Any],
) -> TargetVisibility:
    """Return what a sensor may see of a target at rest. Parameters: as of _reasons_by_placement."""
    expected, possible = (
        _reasons_by_placement(
            s,
            shape,
            rows,
            placement_by_frame,
            T_robot_target=T_robot_target,
            options=options,
        )
        for s in (replace(sensor, margin=np.zeros(6)), sensor)
    )
    return TargetVisibility(
        shape=shape,
        T_robot_target=T_robot_target[rows],
        expected_reasons=expected,
        possible_reasons=possible,
        n_moving_views=0,
        has_known_pose=sensor is not UNKNOWN_POSE,
    )


def _reasons_by_placement(
    sensor: PosedSensor,
    shape: TargetShape,
    rows: np.ndarray,
    placement_by_frame: np.ndarray,
    *,
    T_robot_target: np.ndarray,
    options: dict[str, Any],
) -> tuple[str, ...]:
    """Return why each placement of the rows (n,) is not in view; "" for those that crop would read.

    placement_by_frame: placement of each frame, or -1. options: block crop.
    """
    reasons = select_frames(sensor, shape, placement_by_frame, T_robot_target, options)
    by_row = {k: set(reasons[placement_by_frame == k]) for k in rows}
    return tuple(
        NO_FRAME_REASON if not by_row[k] else "" if "" in by_row[k] else min(by_row[k])
        for k in rows
    )


def _count_moving_views(
    sensor: PosedSensor,
    shape: TargetShape,
    trajectory: Trajectory,
    T_body_target: np.ndarray | None,
    frames: Columns,
    *,
    block: dict[str, Any],
    options: dict[str, Any],
) -> int:
    """Return how many views of a moving target crop would read."""
    views = select_moving_views(
        sensor,
        shape,
        trajectory,
        np.eye(4) if T_body_target is None else T_body_target,
        frames["stamp_ns"],
        time_offset={"value": block["time_offset_s"], "sigma": block["time_offset_sigma_s"]},
        options=options,
    )
    return len(views)
