"""The robot's markers, re-attached before a session: where its MCS body then sits on the robot."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calib.estimation.corrections.base import EstimableCorrection
from calib.estimation.corrections.correction_estimate import correction_estimates
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.corrections.number_wording import format_twist_sigma
from calib.estimation.estimate_state import get_correction_values
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.pose_chain import ROBOT_MARKERS
from calib.geometry.se3 import invert_pose, se3_exp, se3_log
from calib.io.pose_block import pose_json

MARKERS_PRIOR_SIGMA = np.repeat([0.5, np.radians(60.0)], 3)  # m, rad: anywhere on a robot
TWIST_STEP = 1e-6  # m, rad; finite difference


@dataclass(frozen=True)
class RobotMarkersCorrection(EstimableCorrection):
    """Twist (6,) of a session's MCS body in the robot frame of the other sessions.

    T_robot_markers: (4, 4) initial value.
    """

    name = ROBOT_MARKERS
    T_robot_markers: np.ndarray = field(repr=False)

    @property
    def initial_values(self) -> np.ndarray:
        return se3_log(self.T_robot_markers)

    def affects(self, setup: Setup, group: MeasurementGroup) -> bool:
        return setup.placements[group.placement].session == self.subject

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        setup, state = linearization.setup, linearization.state
        theta = get_correction_values(setup, state, ROBOT_MARKERS, self.subject)
        if theta is None:
            raise ValueError(f"the markers of session {self.subject} are not estimated")
        T = state.T_robot_sensor[linearization.group.sensor]
        T_markers_sensor = invert_pose(se3_exp(theta)) @ T
        moved = invert_pose(T) @ se3_exp(theta + TWIST_STEP * np.eye(6)) @ T_markers_sensor
        residuals = [
            linearization.residuals_with(T_sensor_target=M @ linearization.T_sensor_target)
            for M in moved
        ]
        return (np.stack(residuals) - linearization.assignment.standardized.T) / TWIST_STEP

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"the robot's markers of session {self.subject} are shifted along and about the "
            f"robot's x, y, z by {format_twist_sigma(values, sigma)}"
        )


def make_markers_corrections(
    poses_by_session: Mapping[str, Mapping[str, np.ndarray]],
    remounted_sessions: Collection[str],
) -> list[RobotMarkersCorrection]:
    """Return a correction for every session whose markers were re-attached.

    If they were in all sessions, the first session defines the robot frame. Initial values come
    from the first sensor with a pose both in the session and in one that is not re-attached.

    poses_by_session: session -> sensor -> T_robot_sensor (4, 4), the working pose of extract.
    """
    fixed = [s for s in poses_by_session if s not in remounted_sessions]
    fixed = fixed or list(poses_by_session)[:1]
    return [
        RobotMarkersCorrection(
            session, MARKERS_PRIOR_SIGMA, _initial_markers_pose(poses_by_session, session, fixed)
        )
        for session in poses_by_session
        if session not in fixed
    ]


def _initial_markers_pose(
    poses_by_session: Mapping[str, Mapping[str, np.ndarray]],
    session: str,
    fixed_sessions: list[str],
) -> np.ndarray:
    """Return T_robot_markers (4, 4) from a sensor with a pose in both, or the identity."""
    for name, T_robot_sensor in sorted(poses_by_session[session].items()):
        for fixed in fixed_sessions:
            if name in poses_by_session[fixed]:
                return poses_by_session[fixed][name] @ invert_pose(T_robot_sensor)
    return np.eye(4)


def robot_markers_json(setup: Setup, result: EstimationResult) -> dict[str, Any]:
    """Return {session: {T_robot_markers, covariance}} of the sessions with re-attached markers."""
    return {
        estimate.correction.subject: _markers_json(estimate.values, estimate.covariance)
        for estimate in correction_estimates(setup, result)
        if estimate.correction.name == ROBOT_MARKERS
    }


def _markers_json(twist: np.ndarray, covariance: np.ndarray) -> dict[str, Any]:
    """Return the pose of a twist (6,), and its covariance (6, 6) as a right perturbation."""
    T = se3_exp(twist)
    near = invert_pose(T) @ se3_exp(twist + TWIST_STEP * np.eye(6))
    J = se3_log(near).T / TWIST_STEP
    return {"T_robot_markers": pose_json(T), "covariance": (J @ covariance @ J.T).tolist()}
