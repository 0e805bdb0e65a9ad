"""Local motion of a moving target: pose and velocity between the samples of motion capture."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.geometry.se3 import invert_pose, se3_exp, se3_log
from calib.geometry.units import NS_PER_S
from calib.mocap.body_trajectory import SeparateTrajectories, Trajectory, relative_trajectory

LAG_WINDOW_NS = NS_PER_S  # to each side of a view, within which poses are used
FIT_REACH_SAMPLES = 4.5  # to each side of a time, from which pose and velocity are fitted
# The samples may miss the fitted motion by this many of their σ, and by this, m and rad.
MAX_MISFIT_SIGMA, MAX_MISFIT = 3.0, 1e-4


class LocalMotion(NamedTuple):
    """Motion of a target around a time.

    T_robot_body: pose (4, 4) at that time; velocity (6,), per s, and acceleration (6,), per s²: of
    its right twist; sigma_factor: σ of the pose over that of one sample; misfit: (6,) m and rad, by
    which the samples miss the motion.
    """

    T_robot_body: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    sigma_factor: float
    misfit: np.ndarray

    def unresolved_motion(self, sample_sigma: np.ndarray) -> np.ndarray:
        """Return the σ (6,) of the pose by motion between the samples; 0 where these tell it.

        sample_sigma: (6,) of one sample. Samples that are far apart miss how a body speeds up.
        """
        expected = np.maximum(MAX_MISFIT_SIGMA * sample_sigma, MAX_MISFIT)
        return np.where(self.misfit > expected, self.misfit, 0.0)

    def deskew(
        self, xyz: np.ndarray, delays_s: np.ndarray, T_robot_sensor: np.ndarray
    ) -> np.ndarray:
        """Move points to where they are on the target at the time of this motion.

        xyz: (n, 3) points, sensor frame, m; delays_s: (n,) their times after this time, s.
        """
        times, index = np.unique(delays_s, return_inverse=True)
        s = times[:, None]
        xi = s * self.velocity + s**2 / 2 * self.acceleration
        T_sensor_body = invert_pose(T_robot_sensor) @ self.T_robot_body
        T_now_then = (T_sensor_body @ se3_exp(-xi) @ invert_pose(T_sensor_body))[index]
        return np.einsum("nij,nj->ni", T_now_then[:, :3, :3], xyz) + T_now_then[:, :3, 3]


def fit_local_motion(trajectory: Trajectory, time_ns: int) -> LocalMotion | None:
    """Fit a quadratic in the Lie algebra to the samples around a time.

    Returns None if they have a gap or end there. Tricube weights let samples enter and leave with
    weight zero, so the result is smooth in the time.
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
    # A second time around the fitted pose: velocities are then those of the pose itself.
    for _ in range(2):
        xi = se3_log(invert_pose(T) @ poses)
        fitted = H @ xi
        T = T @ se3_exp(fitted[0])
    missed = weight[:, None] * (xi - s[:, None] ** [0, 1, 2] @ fitted)
    share = len(times) / (len(times) - 3) / np.sum(weight**2)
    return LocalMotion(
        T_robot_body=T,
        velocity=fitted[1],
        acceleration=2 * fitted[2],
        sigma_factor=float(np.sqrt(np.sum(H[0] ** 2))),
        misfit=np.sqrt(share * np.sum(missed**2, axis=0)),
    )


@dataclass(frozen=True)
class MovingView:
    """A view of a moving target.

    stamp_ns: of the view; trajectory: of T_robot_body; sigma: (6,) error of each of the two poses
    behind that, in this view alone; separate_trajectories: set if robot and body come from streams
    of their own, whose clocks may differ.
    """

    sensor: str
    stamp_ns: int
    trajectory: Trajectory
    sigma: np.ndarray
    separate_trajectories: SeparateTrajectories | None = None

    def motion_at(self, time_offset_s: float, stream_lag_s: float = 0.0) -> LocalMotion:
        """Return the motion at the view, on the clock of the robot's poses.

        time_offset_s: delay of the sensor's clock; stream_lag_s: delay of the clock of the body's
        poses. Without poses around that time, the motion at the stamp itself. Raises ValueError if
        there are none either.
        """
        trajectory = self.trajectory
        if stream_lag_s and self.separate_trajectories:
            trajectory = self._shift_body_stamps(self.separate_trajectories, stream_lag_s)
        time_ns = self.stamp_ns + round(time_offset_s * NS_PER_S)
        motion = fit_local_motion(trajectory, time_ns) or fit_local_motion(
            self.trajectory, self.stamp_ns
        )
        if motion is None:
            raise ValueError(f"no motion capture poses around stamp {self.stamp_ns} ns")
        return motion

    def _shift_body_stamps(self, separate: SeparateTrajectories, stream_lag_s: float) -> Trajectory:
        """Return T_robot_body around the stamp, the body's stamps moved to the robot's clock."""
        robot, body = separate
        t = body.stamps_ns + round(stream_lag_s * NS_PER_S)
        rows = slice(
            *np.searchsorted(t, [self.stamp_ns - LAG_WINDOW_NS, self.stamp_ns + LAG_WINDOW_NS])
        )
        return relative_trajectory(robot, Trajectory(t[rows], body.poses[rows], body.max_gap_ns))
