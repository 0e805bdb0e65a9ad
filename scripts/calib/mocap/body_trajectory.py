"""Trajectories of bodies: poses at stamps, interpolated between them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.geometry.se3 import interpolate_poses, invert_pose, pose_from_xyz_quat
from calib.geometry.units import NS_PER_S
from calib.io.parquet_tables import Columns

MAX_GAP_PERIODS = 1.5  # of a stream; a longer step lost a pose


@dataclass(frozen=True)
class Trajectory:
    """Poses (n, 4, 4) of a body at increasing stamps (n,), int64 ns.

    Poses are not interpolated over gaps longer than max_gap_ns.
    """

    stamps_ns: np.ndarray
    poses: np.ndarray
    max_gap_ns: int

    def poses_at(self, times_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the poses (m, 4, 4) at times (m,), ns, and whether they are known (m,).

        Poses are interpolated along the geodesic between the samples on both sides. They are
        unknown (and the identity) before the first sample, after the last, and in gaps longer than
        max_gap_ns.
        """
        times_ns = np.asarray(times_ns, np.int64)
        if len(self.stamps_ns) == 0:
            return np.tile(np.eye(4), (len(times_ns), 1, 1)), np.zeros(len(times_ns), bool)
        right = np.clip(
            np.searchsorted(self.stamps_ns, times_ns), 1, max(len(self.stamps_ns) - 1, 1)
        )
        left = right - 1
        right = np.minimum(right, len(self.stamps_ns) - 1)
        gap = self.stamps_ns[right] - self.stamps_ns[left]
        inside = (times_ns >= self.stamps_ns[left]) & (times_ns <= self.stamps_ns[right])
        exact = (times_ns == self.stamps_ns[left]) | (times_ns == self.stamps_ns[right])
        known = inside & (exact | (gap <= self.max_gap_ns))
        fraction = np.where(
            known & (gap > 0), (times_ns - self.stamps_ns[left]) / np.maximum(gap, 1), 0.0
        )
        T = interpolate_poses(self.poses[left], self.poses[right], fraction)
        T[~known] = np.eye(4)
        return T, known


class SeparateTrajectories(NamedTuple):
    """Trajectories of robot and target body in the map, from streams with clocks of their own."""

    robot: Trajectory
    body: Trajectory


def target_trajectories(
    columns: Columns, body: str, bodies: dict[str, str], max_gap_s: float
) -> dict[str, Trajectory]:
    """Return {target: trajectory of T_robot_body} from the columns of mocap.parquet.

    body: MCS body of the robot; bodies: {target: its MCS body}.
    """
    robot = trajectory_from_columns(columns, body, max_gap_s)
    return {
        target: relative_trajectory(robot, trajectory_from_columns(columns, name, max_gap_s))
        for target, name in sorted(bodies.items())
    }


def find_separate_streams(
    columns: Columns,
    body: str,
    bodies: dict[str, str],
    topics: dict[str, list[str]],
    max_gap_s: float,
) -> dict[str, SeparateTrajectories]:
    """Return the trajectories of targets whose poses come from other topics than the robot's.

    Their clocks may differ from the robot's. topics: {body: its topics}.
    """
    robot_topics = set(topics.get(body, ()))
    separate = {
        target: name
        for target, name in sorted(bodies.items())
        if robot_topics and topics.get(name) and not robot_topics & set(topics[name])
    }
    if not separate:
        return {}
    robot = trajectory_from_columns(columns, body, max_gap_s)
    return {
        target: SeparateTrajectories(robot, trajectory_from_columns(columns, name, max_gap_s))
        for target, name in separate.items()
    }


def trajectory_from_columns(columns: Columns, body: str, max_gap_s: float) -> Trajectory:
    """Return the trajectory of a body from the columns of mocap.parquet, without faulty poses."""
    rows = (columns["body"] == body) & (columns["fault"] == "")
    t = columns["stamp_ns"][rows]
    T = pose_from_xyz_quat(
        columns["xyz"][rows].reshape(-1, 3), columns["quat"][rows].reshape(-1, 4)
    )
    return Trajectory(t, T, longest_gap_ns(t, max_gap_s))


def longest_gap_ns(stamps_ns: np.ndarray, max_gap_s: float) -> int:
    """Return the longest gap, ns, to interpolate over: max_gap_s, longer for a slow stream.

    stamps_ns: (n,) of its poses.
    """
    period_ns = float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0
    return max(round(max_gap_s * NS_PER_S), round(MAX_GAP_PERIODS * period_ns))


def relative_trajectory(robot: Trajectory, target: Trajectory) -> Trajectory:
    """Return T_robot_target at the stamps of the target at which the robot is known."""
    T_map_robot, known = robot.poses_at(target.stamps_ns)
    T = invert_pose(T_map_robot[known]) @ target.poses[known]
    return Trajectory(target.stamps_ns[known], T, max(robot.max_gap_ns, target.max_gap_ns))


def window_bounds(t: np.ndarray, half_width_ns: int) -> tuple[np.ndarray, np.ndarray]:
    """Return first and one past last index of the samples within half_width_ns of each sample."""
    return (
        np.searchsorted(t, t - half_width_ns, "left"),
        np.searchsorted(t, t + half_width_ns, "right"),
    )
