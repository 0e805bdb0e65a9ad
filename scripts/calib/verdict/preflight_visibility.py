"""What a sensor may see of the targets in a recording, before any payload is read."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib.initial_guess.initial_guess import NO_SOURCE, SOURCE_DATA
from calib.initial_guess.sensor_guess import SensorGuess
from calib.io.parquet_tables import select_rows
from calib.io.status import Status, failure_status
from calib.mocap.body_trajectory import target_trajectories, trajectory_from_columns
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lens_from_log import find_lens_mismatches
from calib.sensors.sensor_models import with_log_metadata
from calib.targets.target_shapes import target_from_config
from calib.verdict.preflight_guess import PreflightSession, forecast_guess
from calib.verdict.preflight_targets import (
    MovingTarget,
    StillTarget,
    TargetVisibility,
    unknown_pose,
)
from calib.views.field_of_view import PosedSensor
from calib.views.placement_selection import (
    visibility_status,
)
from calib.views.sensor_croppers import Cropper, image_size_reason, make_cropper
from calib.views.target_placements import (
    Columns,
    assign_frames_to_placements,
    compute_target_poses,
    find_still_rows,
    mounts_from_guess,
    trim_placement_ends,
    with_mocap_time,
)


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


def assess_rig_visibility(
    sessions: dict[str, PreflightSession], options: dict[str, Any]
) -> dict[str, dict[str, SensorVisibility]]:
    """Return what each sensor may see, by sensor and session. options: of scripts/preflight.py."""
    mismatches = find_lens_mismatches(
        {
            session: {n: {"camera": s.audit["sensors"][n].get("camera")} for n in s.streams}
            for session, s in sessions.items()
        }
    )
    return {
        name: {
            session_name: (
                SensorVisibility(options["sensors"][name]["kind"], mismatches[name])
                if name in mismatches
                else assess_sensor_visibility(session, name, options)
            )
            for session_name, session in sessions.items()
            if name in session.streams
        }
        for name in sorted(options["sensors"])
    }


def assess_sensor_visibility(
    session: PreflightSession, name: str, options: dict[str, Any]
) -> SensorVisibility:
    """Return what a sensor may see in a session. options: of scripts/preflight.py."""
    block, audit = options["sensors"][name], session.audit["sensors"][name]
    status = Status.from_dict(audit["status"])
    if not status.ok:
        return SensorVisibility(block["kind"], status)
    frames = select_rows(session.frames, session.frames["sensor"] == name)
    frames = with_mocap_time(frames, block["time_offset_s"])
    coverage = _mocap_coverage(session, frames, options)
    status = session.placements.still_target_status()
    if status.ok and not coverage:
        status = _no_mocap_status(name)
    guess = forecast_guess(session, name, options)
    status = status if not status.ok else guess.pose.status
    is_stated = status.ok and guess.pose.source != SOURCE_DATA
    source = guess.pose.source if is_stated else NO_SOURCE
    if not status.ok:
        return SensorVisibility(block["kind"], status, source, coverage)
    cropper = make_cropper(with_log_metadata(block, audit))
    posed = unknown_pose(block["kind"])
    if is_stated:
        posed = _posed_by_guess(cropper, guess, options["crop"])
    lost = _list_lost_targets(session, cropper, guess, audit)
    targets = _assess_targets(session, posed, frames, lost=lost, block=block, options=options)
    if not cropper.has_measurement_time:
        targets = {n: replace(t, n_moving_views=0) for n, t in targets.items()}
    reasons = [reason for t in targets.values() for reason in t.possible_reasons]
    status = visibility_status(name, reasons)
    return SensorVisibility(
        block["kind"], status, source, coverage, targets, cropper.has_measurement_time
    )


def _list_lost_targets(
    session: PreflightSession, cropper: Cropper, guess: SensorGuess, audit: dict[str, Any]
) -> dict[str, str]:
    """Return why targets are not looked for, by name. audit: of the sensor."""
    size_reason = ""
    if "image_size_px" in audit and isinstance(cropper.model, CameraModel):
        size_reason = image_size_reason(cropper.model, audit["image_size_px"])
    if size_reason:
        return dict.fromkeys(session.placements.target_status, size_reason)
    return {n: mount.status.reason for n, mount in guess.mounts.items() if mount.value is None}


def _posed_by_guess(
    cropper: Cropper, guess: SensorGuess, crop_options: dict[str, Any]
) -> PosedSensor:
    assert guess.pose.value is not None and guess.pose.sigma is not None  # its status is ok
    margin = crop_options["margin_sigma"] * np.asarray(guess.pose.sigma)
    return PosedSensor(cropper.model, cropper.check_visibility, guess.pose.value, margin)


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
    lost: dict[str, str],
    block: dict[str, Any],
    options: dict[str, Any],
) -> dict[str, TargetVisibility]:
    """Return what a sensor may see of each target. frames: of the sensor. block: its config.

    lost: why targets are not looked for, by name (_list_lost_targets).
    """
    configs = {n: options["targets"][n] for n in sorted(session.placements.target_status)}
    mounts = mounts_from_guess(configs, {"mounts": {}})
    placements = trim_placement_ends(session.placements.columns, block["time_offset_sigma_s"])
    T_robot_target = compute_target_poses(placements, mounts)
    bodies = {n: config["body"] for n, config in configs.items()}
    trajectories = target_trajectories(session.poses, options["body"], bodies, options["max_gap_s"])
    out = {}
    for name, config in configs.items():
        target = StillTarget(
            target_from_config(config),
            find_still_rows(placements, name),
            assign_frames_to_placements(frames, placements, name),
            T_robot_target,
            options["crop"],
        )
        # The mount of a target may be unknown, too.
        sensor = posed if name in mounts else unknown_pose(block["kind"])
        out[name] = target.visibility(sensor, sensor.model is not None, lost.get(name, ""))
        if target.shape.uses_exact_surface and name not in lost:
            T_body_target = mounts.get(name, np.eye(4))
            moving = MovingTarget(target.shape, trajectories[name], T_body_target, options["crop"])
            n_moving_views = moving.count_views(sensor, frames["stamp_ns"], block)
            out[name] = replace(out[name], n_moving_views=n_moving_views)
    return out
