"""Placements of a target: its still intervals and those between, with their mean poses."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.geometry.se3 import adjoint, invert_pose, mean_pose, pose_to_quat
from calib.geometry.units import NS_PER_S
from calib.io.status import OK, Status
from calib.mocap.body_trajectory import Trajectory
from calib.mocap.rest_noise import RestNoise, slow_noise_columns
from calib.mocap.stillness import (
    StillnessLimits,
    count_effective_samples,
    find_still_intervals,
    fit_residual_drift,
)

DISTANCE_QUANTILE = 0.9  # of a target's distances from the robot, its lever arm


def average_still_pose(
    trajectory: Trajectory,
    interval_ns: Sequence[int] | np.ndarray,
    pose_sigma: np.ndarray,
    slow_noise: dict[str, RestNoise | None] | None = None,
) -> dict[str, Any]:
    """Return the mean pose over a still interval and its covariance, as columns.

    interval_ns: start and end; pose_sigma: (6,) σ of one MCS pose, m and rad; slow_noise: of the
    poses of `robot` and `body`, where it is used. What scatters by it is no white noise.
    """
    rows = (trajectory.stamps_ns >= interval_ns[0]) & (trajectory.stamps_ns <= interval_ns[1])
    mean, xi = mean_pose(trajectory.poses[rows])
    known = [n for n in (slow_noise or {}).values() if n is not None and n.slow.any()]
    duration_s = float(interval_ns[1] - interval_ns[0]) / NS_PER_S
    expected = pose_sigma_at_rest(pose_sigma, known, duration_s)
    scale = single_pose_covariance(mean, expected)
    scatter = max(1.0, np.sqrt(np.mean(np.sum(xi * np.linalg.solve(scale, xi.T).T, 1)) / 6))
    independent = float(rows.sum()) if known else count_effective_samples(xi)
    white = [np.maximum(1.0, n.white / pose_sigma) for n in known]
    factor = scatter * float(np.sqrt(np.mean(np.square(white or [1.0])) / independent))
    return {
        "xyz": mean[:3, 3],
        "quat": pose_to_quat(mean),
        "samples": int(rows.sum()),
        "effective_samples": independent,
        "mean_pose_sigma_factor": factor,
        "covariance": (factor**2 * single_pose_covariance(mean, pose_sigma)).reshape(-1),
        "residual_drift": fit_residual_drift(trajectory.stamps_ns[rows], xi),
    }


def pose_sigma_at_rest(
    pose_sigma: np.ndarray, noises: Sequence[RestNoise], duration_s: float
) -> np.ndarray:
    """Return the σ (6,) by which poses scatter about the mean of a rest.

    noises: measured ones, the largest counts.
    """
    measured = [
        np.sqrt(n.white**2 + np.maximum(n.slow**2 - n.slow_mean_sigma(duration_s) ** 2, 0.0))
        for n in noises
    ]
    return np.asarray(np.max([pose_sigma, *measured], axis=0))


def single_pose_covariance(T_robot_body: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return the covariance (6, 6) of one T_robot_body if both bodies' poses err by sigma (6,)."""
    A = adjoint(invert_pose(T_robot_body))
    return np.diag(sigma**2) + A @ np.diag(sigma**2) @ A.T


def raise_limits_by_noise(
    limits: StillnessLimits, trajectory: Trajectory, noise: dict[str, RestNoise | None]
) -> StillnessLimits:
    """Return the limits of a target relative to the robot where motion capture scatters.

    The robot's rotation noise moves a distant target. noise: of `robot` and `body` at rest. A body
    that scatters more than the robot may sway in a hand: that is motion.
    """
    found = [n.speed_sigma(limits.window_s) for n in noise.values() if n is not None]
    if len(trajectory.poses) == 0 or not found:
        return limits
    robot = found[0] if noise["robot"] is None else noise["robot"].speed_sigma(limits.window_s)
    body = np.minimum(robot, found[-1])
    distances = np.linalg.norm(trajectory.poses[:, :3, 3], axis=1)
    lever_m = float(np.quantile(distances, DISTANCE_QUANTILE))
    moved = lever_m * np.sort(robot[3:])[1:]  # about the two axes that scatter most
    linear = np.linalg.norm(np.concatenate([robot[:3], body[:3], moved]))
    angular = np.linalg.norm(np.concatenate([robot[3:], body[3:]]))
    return limits.raised_by(float(linear), float(angular))


def middle_moving_pose(trajectory: Trajectory, interval_ns: np.ndarray) -> dict[str, Any]:
    """Return the pose nearest to the middle of a moving interval, as columns without covariance."""
    middle_ns = interval_ns[0] + (interval_ns[1] - interval_ns[0]) // 2
    T = trajectory.poses[np.abs(trajectory.stamps_ns - middle_ns).argmin()]
    return {
        "xyz": T[:3, 3],
        "quat": pose_to_quat(T),
        "samples": 1,
        "effective_samples": 1.0,
        "mean_pose_sigma_factor": 1.0,
        "covariance": np.zeros(36),
        "residual_drift": np.zeros(6),
    }


def find_moving_intervals(still_intervals: np.ndarray, stamps_ns: np.ndarray) -> np.ndarray:
    """Return the intervals (k, 2), ns, between still ones, from the first to the last stamp."""
    if len(stamps_ns) == 0:
        return np.zeros((0, 2), np.int64)
    edges = np.concatenate([stamps_ns[:1], still_intervals.reshape(-1), stamps_ns[-1:]])
    edges = edges.reshape(-1, 2)
    return edges[edges[:, 1] > edges[:, 0]]


def find_target_placements(
    target: str,
    trajectory: Trajectory,
    limits: StillnessLimits,
    pose_sigma: np.ndarray,
    slow_noise: dict[str, RestNoise | None],
) -> list[dict[str, Any]]:
    """Return the rows of placements.parquet of one target, by time.

    slow_noise: of the poses of `robot` and `body`, None where it is not used.
    """
    still = find_still_intervals(trajectory, limits)
    moving = find_moving_intervals(still, trajectory.stamps_ns)
    rows = [
        {"target": target, "kind": kind, "start_ns": interval[0], "end_ns": interval[1]}
        | measure_placement(kind, trajectory, interval, pose_sigma, slow_noise)
        for kind, intervals in (("still", still), ("moving", moving))
        for interval in intervals
    ]
    return sorted(rows, key=lambda r: r["start_ns"])


def measure_placement(
    kind: str,
    trajectory: Trajectory,
    interval_ns: np.ndarray,
    pose_sigma: np.ndarray,
    slow_noise: dict[str, RestNoise | None],
) -> dict[str, Any]:
    """Return what motion capture says of a still or moving interval, as columns."""
    duration_s = (interval_ns[1] - interval_ns[0]) / NS_PER_S
    if kind == "still":
        pose = average_still_pose(trajectory, interval_ns, pose_sigma, slow_noise)
    else:
        pose = middle_moving_pose(trajectory, interval_ns)
    for name, noise in slow_noise.items():
        pose |= slow_noise_columns(noise, name, duration_s)
    return pose


def body_status(audit: dict[str, Any], robot: str, body: str) -> Status:
    """Return ok if the log has poses of the robot and of a body. audit: `bodies` of log.json."""
    statuses = (Status.from_dict(audit[name]["status"]) for name in (robot, body))
    return next((status for status in statuses if not status.ok), OK)
