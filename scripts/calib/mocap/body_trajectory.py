"""Poses of a body over time, and between its samples."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import se3


def trajectories(columns, body, bodies, max_gap_s):
    """{target: Trajectory of T_robot_body} from the columns of mocap.parquet; bodies: target -> its
    MCS body."""
    robot = trajectory(columns, body, max_gap_s)
    return {
        target: relative(robot, trajectory(columns, name, max_gap_s))
        for target, name in sorted(bodies.items())
    }


def apart(columns, body, bodies, topics, max_gap_s):
    """{target: Trajectories of robot and body in the map} of those whose poses come by other topics
    than the robot's; topics: {body: its topics}."""
    own = set(topics.get(body, ()))
    others = {t: n for t, n in sorted(bodies.items()) if own and topics.get(n)}
    others = {t: n for t, n in others.items() if not own & set(topics[n])}
    if not others:
        return {}
    robot = trajectory(columns, body, max_gap_s)
    return {t: (robot, trajectory(columns, n, max_gap_s)) for t, n in others.items()}


NS = 1_000_000_000


@dataclass(frozen=True)
class Trajectory:
    """Poses T (n, 4, 4) of a body at the stamps t (n,), int64 ns, increasing; max_gap, ns."""

    t: np.ndarray
    T: np.ndarray
    max_gap: int

    def at(self, t):
        """Poses (m, 4, 4) at the times t (m,), ns, and whether they are known (m,).

        Interpolated along the geodesic between the samples on both sides; unknown, and the
        identity, before the first, after the last and in gaps longer than max_gap.
        """
        t = np.asarray(t, np.int64)
        if len(self.t) == 0:
            return np.tile(np.eye(4), (len(t), 1, 1)), np.zeros(len(t), bool)
        right = np.clip(np.searchsorted(self.t, t), 1, max(len(self.t) - 1, 1))
        left = right - 1
        right = np.minimum(right, len(self.t) - 1)
        gap = self.t[right] - self.t[left]
        inside = (t >= self.t[left]) & (t <= self.t[right])
        exact = (t == self.t[left]) | (t == self.t[right])
        known = inside & (exact | (gap <= self.max_gap))
        fraction = np.where(known & (gap > 0), (t - self.t[left]) / np.maximum(gap, 1), 0.0)
        T = se3.interpolate(self.T[left], self.T[right], fraction)
        T[~known] = np.eye(4)
        return T, known


def trajectory(mocap, body, max_gap_s):
    """The Trajectory of a body from the columns of mocap.parquet; faulty poses are left out."""
    rows = (mocap["body"] == body) & (mocap["fault"] == "")
    t = mocap["t"][rows]
    T = se3.from_xyz_quat(mocap["xyz"][rows].reshape(-1, 3), mocap["quat"][rows].reshape(-1, 4))
    return Trajectory(t, T, round(max_gap_s * NS))


def relative(robot, target):
    """Trajectory of T_robot_target at the target's stamps at which the robot is known."""
    T_map_robot, known = robot.at(target.t)
    T = se3.inverse(T_map_robot[known]) @ target.T[known]
    return Trajectory(target.t[known], T, target.max_gap)


def window(t, half):
    """First and one past the last index of the samples within half, ns, of each sample."""
    return np.searchsorted(t, t - half, "left"), np.searchsorted(t, t + half, "right")
