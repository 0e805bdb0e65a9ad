"""A target in motion as one message saw it: poses and speeds between the samples of the MCS."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.geometry.se3 import invert_pose, se3_exp, se3_log
from calib.geometry.units import NS_PER_S
from calib.mocap.body_trajectory import Trajectory, relative_trajectory

LAG_WINDOW_NS = NS_PER_S  # ns to each side of a view, in which poses may be of use
FIT_REACH_SAMPLES = (
    4.5  # samples of the MCS to each side of a time, from which pose and speed there are taken
)


class LocalMotion(NamedTuple):
    """T_robot_body (4, 4) at a time; velocity (6,) and acceleration (6,) of its right twist, per s
    and per s²; factor: σ of the pose over that of one sample."""

    T_robot_body: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    sigma_factor: float

    def deskew(self, xyz, delays_s, T_robot_sensor):
        """Points xyz (n, 3), sensor frame, taken so long delays_s (n,), s, moved along with the body
        to where it is here."""
        times, at = np.unique(delays_s, return_inverse=True)
        s = times[:, None]
        xi = s * self.velocity + s**2 / 2 * self.acceleration
        X = invert_pose(T_robot_sensor) @ self.T_robot_body
        back = (X @ se3_exp(-xi) @ invert_pose(X))[at]
        return np.einsum("nij,nj->ni", back[:, :3, :3], xyz) + back[:, :3, 3]


def fit_local_motion(trajectory, time_ns):
    """The Fit at t, ns, of a quadratic in the Lie algebra to the samples around it.

    None where they have a gap or end. Tricube weights: samples come and go without weight, so that
    it is smooth in t.
    """
    near = int(np.searchsorted(trajectory.stamps_ns, time_ns))
    rows = slice(max(near - 8, 0), near + 8)
    times, poses = trajectory.stamps_ns[rows], trajectory.poses[rows]
    if len(times) < 8:
        return None
    half = FIT_REACH_SAMPLES * np.median(np.diff(times))
    inside = np.abs(times - time_ns) < half
    times, poses = times[inside], poses[inside]
    ends = np.diff(np.concatenate([[time_ns - half], times, [time_ns + half]]))
    if len(times) < 6 or ends.max() > trajectory.max_gap_ns:
        return None
    s = (times - time_ns) / NS_PER_S
    weight = (1 - np.abs((times - time_ns) / half) ** 3) ** 1.5  # the square root of tricube's
    H = np.linalg.pinv(weight[:, None] * s[:, None] ** [0, 1, 2]) * weight
    T = poses[np.abs(s).argmin()]
    # Again about what was found: velocities are then those of the pose itself.
    for _ in range(2):
        shift, velocity, half_acceleration = H @ se3_log(invert_pose(T) @ poses)
        T = T @ se3_exp(shift)
    return LocalMotion(T, velocity, 2 * half_acceleration, float(np.sqrt(np.sum(H[0] ** 2))))


@dataclass(frozen=True)
class MovingView:
    """What a sensor saw at t, ns, of a body of which a Trajectory of T_robot_body is known, and the
    σ (6,) of what each of the two poses behind that errs by in this view alone. apart: Trajectories
    of robot and body in the map where they come by streams of their own, whose clocks may differ.
    """

    sensor: str
    stamp_ns: int
    trajectory: object
    sigma: np.ndarray
    separate_trajectories: tuple | None = None

    def motion_at(self, time_offset_s, stream_lag_s=0.0):
        """The Fit at t on the clock of the robot's poses, the sensor's being late by an offset, s,
        and that of the body's poses by a lag, s. Where the MCS has none, that at t itself."""
        path = (
            self._shift_body_stamps(stream_lag_s)
            if stream_lag_s and self.separate_trajectories
            else self.trajectory
        )
        return fit_local_motion(
            path, self.stamp_ns + round(time_offset_s * NS_PER_S)
        ) or fit_local_motion(self.trajectory, self.stamp_ns)

    def _shift_body_stamps(self, stream_lag_s):
        """The Trajectory of T_robot_body around t, the body's stamps taken to the robot's clock."""
        robot, body = self.separate_trajectories
        t = body.stamps_ns + round(stream_lag_s * NS_PER_S)
        rows = slice(
            *np.searchsorted(t, [self.stamp_ns - LAG_WINDOW_NS, self.stamp_ns + LAG_WINDOW_NS])
        )
        return relative_trajectory(robot, Trajectory(t[rows], body.poses[rows], body.max_gap_ns))
