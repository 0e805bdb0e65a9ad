"""A target in motion as one message saw it: poses and speeds between the samples of the MCS."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.geometry import se3
from calib.mocap import body_trajectory
from calib.mocap.body_trajectory import NS

AROUND = NS  # ns to each side of a view, in which poses may be of use
REACH = 4.5  # samples of the MCS to each side of a time, from which pose and speed there are taken


class Fit(NamedTuple):
    """T_robot_body (4, 4) at a time; velocity (6,) and acceleration (6,) of its right twist, per s
    and per s²; factor: σ of the pose over that of one sample."""

    T: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    factor: float

    def frozen(self, xyz, after, T_robot_sensor):
        """Points xyz (n, 3), sensor frame, taken so long after (n,), s, moved along with the body
        to where it is here."""
        times, at = np.unique(after, return_inverse=True)
        s = times[:, None]
        xi = s * self.velocity + s**2 / 2 * self.acceleration
        X = se3.inverse(T_robot_sensor) @ self.T
        back = (X @ se3.se3_exp(-xi) @ se3.inverse(X))[at]
        return np.einsum("nij,nj->ni", back[:, :3, :3], xyz) + back[:, :3, 3]


def fit(trajectory, t):
    """The Fit at t, ns, of a quadratic in the Lie algebra to the samples around it.

    None where they have a gap or end. Tricube weights: samples come and go without weight, so that
    it is smooth in t.
    """
    near = int(np.searchsorted(trajectory.t, t))
    rows = slice(max(near - 8, 0), near + 8)
    times, poses = trajectory.t[rows], trajectory.T[rows]
    if len(times) < 8:
        return None
    half = REACH * np.median(np.diff(times))
    inside = np.abs(times - t) < half
    times, poses = times[inside], poses[inside]
    ends = np.diff(np.concatenate([[t - half], times, [t + half]]))
    if len(times) < 6 or ends.max() > trajectory.max_gap:
        return None
    s = (times - t) / NS
    weight = (1 - np.abs((times - t) / half) ** 3) ** 1.5  # the square root of tricube's
    H = np.linalg.pinv(weight[:, None] * s[:, None] ** [0, 1, 2]) * weight
    T = poses[np.abs(s).argmin()]
    # Again about what was found: velocities are then those of the pose itself.
    for _ in range(2):
        shift, velocity, half_acceleration = H @ se3.se3_log(se3.inverse(T) @ poses)
        T = T @ se3.se3_exp(shift)
    return Fit(T, velocity, 2 * half_acceleration, float(np.sqrt(np.sum(H[0] ** 2))))


@dataclass(frozen=True)
class Moving:
    """What a sensor saw at t, ns, of a body of which a Trajectory of T_robot_body is known, and the
    σ (6,) of what each of the two poses behind that errs by in this view alone. apart: Trajectories
    of robot and body in the map where they come by streams of their own, whose clocks may differ.
    """

    sensor: str
    t: int
    trajectory: object
    sigma: np.ndarray
    apart: tuple | None = None

    def at(self, offset, lag=0.0):
        """The Fit at t on the clock of the robot's poses, the sensor's being late by an offset, s,
        and that of the body's poses by a lag, s. Where the MCS has none, that at t itself."""
        path = self._lagging(lag) if lag and self.apart else self.trajectory
        return fit(path, self.t + round(offset * NS)) or fit(self.trajectory, self.t)

    def _lagging(self, lag):
        """The Trajectory of T_robot_body around t, the body's stamps taken to the robot's clock."""
        robot, body = self.apart
        t = body.t + round(lag * NS)
        rows = slice(*np.searchsorted(t, [self.t - AROUND, self.t + AROUND]))
        return body_trajectory.relative(
            robot, body_trajectory.Trajectory(t[rows], body.T[rows], body.max_gap)
        )
