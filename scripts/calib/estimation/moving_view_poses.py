"""Placements and groups of keypoints of targets in motion, and the time offsets they determine."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib.estimation.corrections.clock_offset import TimeOffsetCorrection
from calib.estimation.estimation_problem import MeasurementGroup, Placement, Setup
from calib.estimation.problem_assembly import SessionKeypoints, best_time_offset_guess
from calib.geometry.units import NS_PER_S
from calib.io.parquet_tables import select_rows
from calib.io.pose_block import pose_sigma_from_config
from calib.mocap.body_trajectory import (
    SeparateTrajectories,
    Trajectory,
    find_separate_streams,
    target_trajectories,
)
from calib.mocap.moving_pose_fit import MovingView, fit_local_motion
from calib.mocap.placements import single_pose_covariance
from calib.views.pose_selection import space_evenly

MAX_KEYPOINTS_PER_VIEW = 400  # more do not improve its pose between two motion capture samples
MOVING_VIEW_KINDS = ("pattern_corner", "cylinder_limb", "target_surface")


@dataclass(frozen=True)
class MovingSession:
    """One session with targets in motion.

    mocap_columns: of mocap.parquet; topics: of the motion capture, by body; keypoints: columns of
    moving_keypoints.parquet by sensor.
    """

    session: str
    mocap_columns: dict[str, np.ndarray]
    topics: dict[str, list[str]]
    keypoints: dict[str, dict[str, np.ndarray]]


@dataclass(frozen=True)
class TargetPath:
    """Where one target of a session moves.

    T_body_target: (4, 4); trajectory: of T_robot_body; separate_trajectories: of robot and body in
    the map, where they come by streams of their own, whose clocks may differ; slow_sigma: (2, 6) of
    the slow noise of the robot's and the body's poses.
    """

    target: str
    T_body_target: np.ndarray
    trajectory: Trajectory
    separate_trajectories: SeparateTrajectories | None = None
    slow_sigma: np.ndarray = field(default_factory=lambda: np.zeros((2, 6)))


def make_moving_placement(
    path: TargetPath, *, session: str, sensor: str, time_ns: int, mocap_noise: dict[str, Any]
) -> Placement | None:
    """Return the Placement of a moving view, or None where the motion capture has a gap.

    time_ns: on the clock of the motion capture; mocap_noise: block with pose_sigma and
    pose_bias_sigma.
    """
    motion = fit_local_motion(path.trajectory, time_ns)
    if motion is None:
        return None
    white, bias = (
        pose_sigma_from_config(mocap_noise[k]) for k in ("pose_sigma", "pose_bias_sigma")
    )
    # The bias of the motion capture is neither constant nor new in every view. It counts twice:
    # once for all views, so that many determine a pose no better than one placement, and per view.
    robot_bias, body_bias = np.maximum(bias, path.slow_sigma)
    sample_sigma = np.sqrt(np.diag(single_pose_covariance(motion.T_robot_body, white)))
    unresolved = motion.unresolved_motion(sample_sigma)
    pose_sigma = np.hypot(motion.sigma_factor * white, np.maximum(robot_bias, body_bias))
    view = MovingView(
        sensor=sensor,
        stamp_ns=time_ns,
        trajectory=path.trajectory,
        sigma=np.hypot(pose_sigma, unresolved),
        separate_trajectories=path.separate_trajectories,
    )
    return Placement(
        session=session,
        target=path.target,
        T_robot_body=motion.T_robot_body,
        T_body_target=path.T_body_target,
        mocap_sigma=body_bias,
        robot_mocap_sigma=robot_bias,
        moving_view=view,
    )


def build_moving_groups(
    keypoints: dict[str, np.ndarray],
    paths: dict[str, TargetPath],
    *,
    session: str,
    sensor: str,
    offset_s: float,
    mocap_noise: dict[str, Any],
    first_index: int,
) -> tuple[list[Placement], list[MeasurementGroup]]:
    """Return placements and groups of a sensor's moving views, numbered from first_index.

    paths: by target; offset_s: initial guess of the time offset, added to the stamps. The time of
    a view is the mean of its keypoints'.
    """
    placements: list[Placement] = []
    groups: list[MeasurementGroup] = []
    for view in sorted(set(keypoints["view"].tolist())):
        columns = _keypoints_of_view(keypoints, view, offset_s)
        if columns is None:
            continue
        stamps = columns["stamp_ns"]
        placement = make_moving_placement(
            paths[str(columns["target"][0])],
            session=session,
            sensor=sensor,
            time_ns=int(stamps[0]) + int(np.mean(stamps - stamps[0])),
            mocap_noise=mocap_noise,
        )
        if placement is None:
            continue
        group = MeasurementGroup(
            sensor=sensor,
            placement=first_index + len(placements),
            kind=str(columns["kind"][0]),
            keypoints=columns,
            is_moving=True,
        )
        groups.append(group)
        placements.append(placement)
    return placements, groups


def _keypoints_of_view(
    keypoints: dict[str, np.ndarray], view: int, offset_s: float
) -> dict[str, np.ndarray] | None:
    """Return at most MAX_KEYPOINTS_PER_VIEW usable keypoints of a view, or None without any.

    Their stamps are shifted by offset_s.
    """
    rows = np.flatnonzero(
        (keypoints["view"] == view) & np.isin(keypoints["kind"], MOVING_VIEW_KINDS)
    )
    if len(rows) == 0:
        return None
    columns = select_rows(keypoints, rows[space_evenly(len(rows), MAX_KEYPOINTS_PER_VIEW)])
    return columns | {"stamp_ns": columns["stamp_ns"] + round(offset_s * NS_PER_S)}


def add_moving_views(
    setup: Setup,
    *,
    moving_sessions: Sequence[MovingSession],
    sessions: Sequence[SessionKeypoints],
    options: dict[str, Any],
) -> Setup:
    """Return the Setup with moving views, and the time offsets of the sensors that have some."""
    placements, groups = list(setup.placements), list(setup.groups)
    for moving in moving_sessions:
        paths = _target_paths(setup, moving, options)
        for sensor, keypoints in moving.keypoints.items():
            keypoints = select_rows(keypoints, np.isin(keypoints["target"], list(paths)))
            if sensor in setup.models and len(keypoints["view"]):
                new_placements, new_groups = build_moving_groups(
                    keypoints,
                    paths,
                    session=moving.session,
                    sensor=sensor,
                    offset_s=best_time_offset_guess(sensor, sessions)["value"],
                    mocap_noise=options["mocap"],
                    first_index=len(placements),
                )
                placements += new_placements
                groups += new_groups
    time_offsets = [
        TimeOffsetCorrection(n, np.array([best_time_offset_guess(n, sessions)["sigma"]]))
        for n in sorted({g.sensor for g in groups if g.is_moving})
    ]
    corrections = (*setup.corrections, *time_offsets)
    return replace(setup, placements=placements, groups=groups, corrections=corrections)


def _target_paths(
    setup: Setup, moving: MovingSession, options: dict[str, Any]
) -> dict[str, TargetPath]:
    """Return the paths of the targets that have placements at rest in the same session."""
    mounts = {p.target: p.T_body_target for p in setup.placements if p.session == moving.session}
    bodies = {n: block["body"] for n, block in options["targets"].items() if n in mounts}
    robot, max_gap_s = options["body"], options["max_gap_s"]
    trajectories = target_trajectories(moving.mocap_columns, robot, bodies, max_gap_s)
    streams = find_separate_streams(moving.mocap_columns, robot, bodies, moving.topics, max_gap_s)
    return {
        n: TargetPath(
            n, mounts[n], trajectories[n], streams.get(n), _slow_sigma(setup, moving.session, n)
        )
        for n in bodies
    }


def _slow_sigma(setup: Setup, session: str, target: str) -> np.ndarray:
    """Return the largest σ (2, 6) of slow noise in the placements of a target."""
    noises = [
        p.slow_noise.sigma
        for p in setup.placements
        if (p.session, p.target) == (session, target) and p.slow_noise is not None
    ]
    return np.max(noises, axis=0) if noises else np.zeros((2, 6))
