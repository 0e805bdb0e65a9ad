"""The scale of the motion capture in a session: its metres, too long or too short.

It acts on all sensors and targets alike. A wrong size of a pattern acts on cameras alone, a wrong
outline on edges alone, a range error on one lidar alone: the scale explains what they agree on.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import pose_chain
from calib.estimation.corrections.base import (
    EstimableCorrection,
    TestableCorrection,
    is_compared_exactly,
)
from calib.estimation.corrections.correction_estimate import correction_estimates
from calib.estimation.corrections.group_linearization import FINITE_STEP_RATIO, GroupLinearization
from calib.estimation.corrections.number_wording import choose_by_sign, format_value_sigma
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.pose_chain import MOCAP_SCALE
from calib.geometry.se3 import invert_pose, make_pose
from calib.geometry.units import SHARE_TO_PERCENT
from calib.io.config_change import ConfigChange, pipeline_change

SCALE_SIGMA = 0.01  # of the prior: a wand is measured, or copied from its label, to 1 %


@dataclass(frozen=True)
class MocapScaleCorrection(TestableCorrection, EstimableCorrection):
    """Relative error of all distances that the motion capture states in a session."""

    name = MOCAP_SCALE
    min_lead = 10.0
    max_size = 10 * SCALE_SIGMA

    def affects(self, setup: Setup, group: MeasurementGroup) -> bool:
        session = setup.placements[group.placement].session
        return session == self.subject and is_compared_exactly(setup, group)

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        setup, state, group = linearization.setup, linearization.state, linearization.group
        T_robot_sensor = state.T_robot_sensor[group.sensor]
        offset = pose_chain.robot_to_body_offset(setup, state, group.placement)
        nearer = make_pose(None, -FINITE_STEP_RATIO * offset)
        T_sensor_target = invert_pose(T_robot_sensor) @ nearer @ T_robot_sensor
        moved = linearization.residuals_with(
            T_sensor_target=T_sensor_target @ linearization.T_sensor_target
        )
        return (moved - linearization.assignment.standardized.T)[None] / FINITE_STEP_RATIO

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"the motion capture's distances in session {self.subject} are "
            f"{format_value_sigma(values[0], sigma[0], SHARE_TO_PERCENT, '%')} "
            f"{choose_by_sign(values[0], 'too long', 'too short')}: its scale is wrong"
        )

    @property
    def remedy(self) -> str:
        return (
            "calibrate the motion capture again with a wand of known length, or measure the "
            "distance of two markers with a tape against what it states; to correct the scale of "
            "this recording, set solve.estimate.mocap_scale: true"
        )

    def config_change(self, values: np.ndarray) -> ConfigChange:
        # Not true: with a rival that is as good, it would hide the error.
        return pipeline_change("solve.estimate.mocap_scale", "auto")

    def add_to_setup(self, setup: Setup) -> Setup:
        return replace(setup, corrections=(*setup.corrections, self))


def make_scale_corrections(setup: Setup) -> Iterator[TestableCorrection]:
    """Yield the correction of the motion capture's scale of every session."""
    for session in sorted({p.session for p in setup.placements}):
        yield MocapScaleCorrection(session, np.array([SCALE_SIGMA]))


def mocap_scales_json(setup: Setup, result: EstimationResult) -> dict[str, dict[str, float]]:
    """Return {session: {value, sigma}} of the scale errors that were estimated, as shares."""
    return {
        e.correction.subject: {"value": float(e.values[0]), "sigma": float(e.sigma[0])}
        for e in correction_estimates(setup, result)
        if e.correction.name == MOCAP_SCALE
    }
