"""Time offsets: of a sensor's clock, t_mcs = stamp + offset, and between two MCS streams."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.estimation import pose_chain
from calib.estimation.corrections.base import (
    ClockCorrection,
    EstimableCorrection,
    is_compared_exactly,
)
from calib.estimation.corrections.correction_estimate import (
    CorrectionEstimate,
    correction_estimates,
    find_correction_estimate,
)
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.corrections.number_wording import choose_by_sign
from calib.estimation.corrections.score_test import gain_p_value, likelihood_gain
from calib.estimation.estimate_state import STREAM_LAG, clock_delays, get_local_motion
from calib.estimation.estimation_problem import MeasurementGroup, Placement, Setup
from calib.estimation.estimation_result import EstimationResult
from calib.geometry.se3 import adjoint, invert_pose, se3_exp, se3_log
from calib.geometry.units import MS_PER_S
from calib.io.config_change import pipeline_change
from calib.mocap.moving_pose_fit import MovingView

TIME_OFFSET = "time_offset"  # name of the correction
FINITE_STEP_S = 1e-6
STREAM_LAG_PRIOR_S = 0.05  # σ of the prior of a lag between two streams of the MCS
LAG_STEP_S = 1e-3  # finite difference between samples of the MCS
MAX_CLOCK_SIGMA_RATIO = 0.3  # σ of an offset over the prior's: not observable above this


@dataclass(frozen=True)
class TimeOffsetCorrection(ClockCorrection):
    """Time offset of a sensor, s, beyond the initial guess."""

    name = TIME_OFFSET

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return time_offset_derivative(linearization)

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"the stamps of {self.subject} are {MS_PER_S * abs(values[0]):.3g} ± "
            f"{MS_PER_S * sigma[0]:.2g} ms {choose_by_sign(values[0], 'early', 'late')} relative "
            "to those of the motion capture"
        )

    def delay_s(self, values: np.ndarray, placement: Placement) -> float:
        return values[0]


@dataclass(frozen=True)
class StreamLagCorrection(EstimableCorrection):
    """How late the clock of a target's poses is relative to that of the robot's poses, s.

    For targets whose poses come from MCS streams of their own: t_robot = t_target + lag.
    """

    name = STREAM_LAG

    def affects(self, setup: Setup, group: MeasurementGroup) -> bool:
        target = setup.placements[group.placement].target
        return group.is_moving and target == self.subject and is_compared_exactly(setup, group)

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return stream_lag_derivative(linearization)

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"the motion capture stamps {self.subject} {MS_PER_S * abs(values[0]):.3g} ± "
            f"{MS_PER_S * sigma[0]:.2g} ms too {choose_by_sign(values[0], 'early', 'late')} "
            "relative to the robot"
        )


def moving_view_of(placement: Placement) -> MovingView:
    """Return the moving view of a placement; raises ValueError for a target at rest."""
    if placement.moving_view is None:
        raise ValueError(f"placement of {placement.target}: the target is at rest")
    return placement.moving_view


def make_stream_lag_correction(target: str) -> StreamLagCorrection:
    """Return the correction of the lag of a target's poses."""
    return StreamLagCorrection(target, np.array([STREAM_LAG_PRIOR_S]))


def time_offset_derivative(linearization: GroupLinearization) -> np.ndarray:
    """Return the derivatives (1, k, n) of a moving view's residuals by the time offset, per s."""
    placement = linearization.group.placement
    motion = get_local_motion(linearization.setup, linearization.state, placement)
    return _velocity_derivative(linearization, motion.velocity)


def stream_lag_derivative(linearization: GroupLinearization) -> np.ndarray:
    """Return the derivatives (1, k, n) of a moving view's residuals by the stream lag, per s."""
    setup, values = linearization.setup, linearization.state.correction_values
    place = setup.placements[linearization.group.placement]
    offset, lag = clock_delays(setup, values, place)
    before, after = (
        moving_view_of(place).motion_at(offset, lag + s).T_robot_body
        for s in (-LAG_STEP_S, LAG_STEP_S)
    )
    velocity = se3_log(invert_pose(before) @ after) / (2 * LAG_STEP_S)
    return _velocity_derivative(linearization, velocity)


def _velocity_derivative(linearization: GroupLinearization, velocity: np.ndarray) -> np.ndarray:
    """Return the derivatives (1, k, n) by time, if the body moves with a right twist (6,)."""
    setup, state = linearization.setup, linearization.state
    T_body_target = pose_chain.T_body_target(setup, state, linearization.group.placement)
    step = FINITE_STEP_S * (adjoint(invert_pose(T_body_target)) @ velocity)
    ahead = linearization.residuals_with(
        T_sensor_target=linearization.T_sensor_target @ se3_exp(step)
    )
    return (ahead - linearization.assignment.standardized.T)[None] / FINITE_STEP_S


def stream_lags_json(setup: Setup, result: EstimationResult) -> dict[str, dict[str, float]]:
    """Return {target: {value, sigma}}, s, of the stream lags that moving views constrain."""
    return {
        estimate.correction.subject: {
            "value": float(estimate.values[0]),
            "sigma": float(estimate.sigma[0]),
        }
        for estimate in correction_estimates(setup, result)
        if estimate.correction.name == STREAM_LAG
        and estimate.sigma_ratio[0] < MAX_CLOCK_SIGMA_RATIO
    }


def suspected_clock_errors_json(setup: Setup, result: EstimationResult) -> list[dict[str, Any]]:
    """Return one suspected error per sensor with moving views whose clock must not be estimated.

    Same keys as find_suspected_errors. Correcting it moves no pose: still placements fix the poses.
    """
    return [
        _suspected_clock_error_json(setup, estimate)
        for estimate in correction_estimates(setup, result)
        if estimate.correction.name == TIME_OFFSET
    ]


def _suspected_clock_error_json(setup: Setup, estimate: CorrectionEstimate) -> dict[str, Any]:
    sensor, (offset,), (sigma,) = estimate.correction.subject, estimate.values, estimate.sigma
    gain = float(likelihood_gain(offset, sigma))
    return {
        "name": TIME_OFFSET,
        "subject": sensor,
        "description": estimate.correction.describe(estimate.values, estimate.sigma),
        "remedy": f"set solve.estimate.time_offset: auto, or change sensors.{sensor}.time_offset_s "
        f"by {MS_PER_S * offset:+.3g} ms",
        "change": pipeline_change("solve.estimate.time_offset", "auto"),
        "estimate": [float(offset)],
        "sigma": [float(sigma)],
        "log_likelihood_gain": gain,
        "p_value": gain_p_value(gain, 1),
        "explained_share": {},
        "pose_shift": {
            n: {"m": 0.0, "rad": 0.0, "shift": [0.0] * 6, "sigmas": 0.0} for n in setup.models
        },
        "alternatives": [],
    }


def time_offset_json(
    sensor: str, setup: Setup, result: EstimationResult, guess: dict[str, Any]
) -> dict[str, Any]:
    """Return {time_offset_s: {value, sigma} or None, time_offset_note} of a sensor.

    The value is relative to its stamps: the initial guess plus the estimated correction.
    """
    n_views = sum(g.is_moving and g.sensor == sensor for g in setup.groups)
    estimate = find_correction_estimate(setup, result, TIME_OFFSET, sensor)
    if not n_views or estimate is None:
        return {"time_offset_s": None, "time_offset_note": "not observable: no relative motion"}
    if estimate.sigma_ratio[0] > MAX_CLOCK_SIGMA_RATIO:
        return {
            "time_offset_s": None,
            "time_offset_note": f"not observable: {n_views} moving views constrain it only to "
            f"± {MS_PER_S * estimate.sigma[0]:.2g} ms",
        }
    value = guess["time_offset_s"]["value"] + estimate.values[0]
    return {
        "time_offset_s": {"value": float(value), "sigma": float(estimate.sigma[0])},
        "time_offset_note": f"from {n_views} views of moving targets",
    }
