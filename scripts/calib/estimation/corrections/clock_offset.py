"""A sensor's clock against that of the MCS: t_mcs = stamp + offset."""

import numpy as np

from calib.estimation import pose_chain
from calib.estimation.corrections.correction import Correction
from calib.estimation.corrections.score_test import gain_p_value, likelihood_gain
from calib.estimation.estimate_state import STREAM_LAG, clock_delays, get_local_motion
from calib.geometry.se3 import adjoint, invert_pose, se3_exp, se3_log

TIME_OFFSET = "time_offset"  # name of the correction
FINITE_STEP_S = 1e-6  # step of a finite difference
STREAM_LAG_PRIOR_S = 0.05  # σ of the prior of a lag between two streams of the MCS
LAG_STEP_S = 1e-3  # s, of a finite difference: between samples of the MCS
MAX_CLOCK_SIGMA_RATIO = 0.3  # of the prior's σ: an offset that is told no better is not told


def make_time_offset_correction(name, sigma):
    """The Hypothesis of a sensor's offset, s, with the σ of its prior, s."""
    return Correction(
        TIME_OFFSET, name, True, (), 1, time_offset_derivative, lambda theta, sigma: "", "",
        np.array([sigma]), lambda model, theta, placement: model, is_moving_only=True,
        clock_delay=lambda theta, place: theta[0],
    )  # fmt: skip


def time_offset_derivative(view):
    """(1, k, n): what a later look at the MCS does to the residuals of a view in motion."""
    return _velocity_derivative(
        view, get_local_motion(view.setup, view.state, view.group.placement).velocity
    )


def _velocity_derivative(view, velocity):
    """(1, k, n): residuals per second of a body that moves with a right twist (6,), per s."""
    T_body_target = pose_chain.T_body_target(view.setup, view.state, view.group.placement)
    eta = adjoint(invert_pose(T_body_target)) @ velocity
    ahead = view.residuals_with(T_sensor_target=view.T_sensor_target @ se3_exp(FINITE_STEP_S * eta))
    return (ahead - view.assignment.standardized.T)[None] / FINITE_STEP_S


def make_stream_lag_correction(target):
    """The Hypothesis of how late the clock of a target's poses is against that of the robot's, s,
    where they come by streams of their own: t_robot = t_target + lag."""
    return Correction(
        STREAM_LAG, target, False, (), 1, stream_lag_derivative, lambda theta, sigma: "", "",
        np.array([STREAM_LAG_PRIOR_S]), lambda model, theta, placement: model, is_moving_only=True,
    )  # fmt: skip


def stream_lag_derivative(view):
    """(1, k, n): what a later target does to the residuals of a view in motion."""
    place = view.setup.placements[view.group.placement]
    offset, lag = clock_delays(view.setup, view.state.correction_values, place)
    before, after = (
        place.moving_view.motion_at(offset, lag + s).T_robot_body for s in (-LAG_STEP_S, LAG_STEP_S)
    )
    return _velocity_derivative(view, se3_log(invert_pose(before) @ after) / (2 * LAG_STEP_S))


def stream_lags_json(setup, result):
    """{target: {value, sigma}} of the lags that were estimated, as far as views in motion tell
    them, s."""
    if result.solve_result is None:
        return {}
    spread, out = np.diag(result.solve_result.covariance)[setup.n_chain_unknowns :], {}
    for h, at in setup.correction_slices:
        (ratio,) = np.sqrt(spread[at]) if h.name == STREAM_LAG else (1.0,)
        if ratio < MAX_CLOCK_SIGMA_RATIO:
            out[h.subject] = {
                "value": float(result.state.correction_values[at][0]),
                "sigma": float(ratio * STREAM_LAG_PRIOR_S),
            }
    return out


def suspected_clock_errors_json(setup, result):
    """As suspicion.suspicions, of every sensor with views in motion: its clock, not to be
    estimated, is off. Mending it moves no pose: that is told by still placements."""
    spread = np.diag(result.solve_result.covariance)[setup.n_chain_unknowns :]
    out = []
    for h, at in setup.correction_slices:
        if h.name != TIME_OFFSET:
            continue
        (late,), (sigma,) = (
            result.state.correction_values[at],
            np.sqrt(spread[at]) * setup.correction_sigma[at],
        )
        gain = float(likelihood_gain(late, sigma))
        out.append(
            {
                "name": TIME_OFFSET,
                "subject": h.subject,
                "description": f"the stamps of {h.subject} are {1e3 * abs(late):.3g} ± {1e3 * sigma:.2g} ms "
                f"{'early' if late > 0 else 'late'} against those of the motion capture",
                "remedy": f"write sensors.{h.subject}.time_offset_s {1e3 * late:+.3g} ms farther, or "
                "solve.estimate.time_offset: auto",
                "estimate": [float(late)],
                "sigma": [float(sigma)],
                "log_likelihood_gain": gain,
                "p_value": gain_p_value(gain, 1),
                "explained_share": {},
                "pose_shift": {n: {"m": 0.0, "rad": 0.0, "sigmas": 0.0} for n in setup.models},
                "alternatives": [],
            }
        )
    return out


def time_offset_json(sensor, setup, result, guess):
    """{time_offset_s: {value, sigma} or None, clock: what there is to say of it} of a sensor.

    The value is that against its stamps: the first guess, and what was found beside it.
    """
    views = sum(g.is_moving and g.sensor == sensor for g in setup.groups)
    at = setup.correction_slice(TIME_OFFSET, sensor)
    if not views or at is None or result.solve_result is None:
        return {"time_offset_s": None, "time_offset_note": "not observable: no relative motion"}
    (prior,), (theta,) = setup.correction_sigma[at], result.state.correction_values[at]
    (ratio,) = np.sqrt(np.diag(result.solve_result.covariance)[setup.n_chain_unknowns :][at])
    if ratio > MAX_CLOCK_SIGMA_RATIO:
        return {
            "time_offset_s": None,
            "time_offset_note": f"not observable: {views} views in motion tell it no "
            f"better than ± {1e3 * ratio * prior:.2g} ms",
        }
    value = guess["time_offset_s"]["value"] + theta
    found = {"value": float(value), "sigma": float(ratio * prior)}
    return {"time_offset_s": found, "time_offset_note": f"from {views} views of targets in motion"}
