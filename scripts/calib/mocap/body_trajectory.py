"""Poses of a body over time, and between its samples."""

from dataclasses import dataclass

import numpy as np

from calib.geometry.se3 import interpolate_poses, invert_pose, pose_from_xyz_quat
from calib.geometry.units import NS_PER_S


def target_trajectories(columns, body, bodies, max_gap_s):
    """{target: Trajectory of T_robot_body} from the columns of mocap.parquet; bodies: target -> its
    MCS body."""
    robot = trajectory_from_columns(columns, body, max_gap_s)
    return {
        target: relative_trajectory(robot, trajectory_from_columns(columns, name, max_gap_s))
        for target, name in sorted(bodies.items())
    }


def find_separate_streams(columns, body, bodies, topics, max_gap_s):
    """{target: Trajectories of robot and body in the map} of those whose poses come by other topics
    than the robot's; topics: {body: its topics}."""
    own = set(topics.get(body, ()))
    others = {t: n for t, n in sorted(bodies.items()) if own and topics.get(n)}
    others = {t: n for t, n in others.items() if not own & set(topics[n])}
    if not others:
        return {}
    robot = trajectory_from_columns(columns, body, max_gap_s)
    return {t: (robot, trajectory_from_columns(columns, n, max_gap_s)) for t, n in others.items()}


@dataclass(frozen=True)
class Trajectory:
    """Poses T (n, 4, 4) of a body at the stamps t (n,), int64 ns, increasing; max_gap, ns."""

    stamps_ns: np.ndarray
    poses: np.ndarray
    max_gap_ns: int

    def poses_at(self, times_ns):
        """Poses (m, 4, 4) at the times times_ns (m,), ns, and whether they are known (m,).

        Interpolated along the geodesic between the samples on both sides; unknown, and the
        identity, before the first, after the last and in gaps longer than max_gap.
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


def trajectory_from_columns(columns, body, max_gap_s):
    """The Trajectory of a body from the columns of mocap.parquet; faulty poses are left out."""
    rows = (columns["body"] == body) & (columns["fault"] == "")
    t = columns["stamp_ns"][rows]
    T = pose_from_xyz_quat(
        columns["xyz"][rows].reshape(-1, 3), columns["quat"][rows].reshape(-1, 4)
    )
    return Trajectory(t, T, round(max_gap_s * NS_PER_S))


def relative_trajectory(robot, target):
    """Trajectory of T_robot_target at the target's stamps at which the robot is known."""
    T_map_robot, known = robot.poses_at(target.stamps_ns)
    T = invert_pose(T_map_robot[known]) @ target.poses[known]
    return Trajectory(target.stamps_ns[known], T, target.max_gap_ns)


def _window_bounds(t, half):
    """First and one past the last index of the samples within half, ns, of each sample."""
    return np.searchsorted(t, t - half, "left"), np.searchsorted(t, t + half, "right")
