"""A sensor's clock against that of the MCS: t_mcs = stamp + offset."""

import numpy as np

from calib.estimation import estimate_state, pose_chain
from calib.estimation.corrections import score_test
from calib.estimation.corrections.correction import Hypothesis
from calib.geometry import se3

CLOCK = "time_offset"  # name of the correction
SECOND = 1e-6  # step of a finite difference
STREAM_S = 0.05  # σ of the prior of a lag between two streams of the MCS
LAG_STEP = 1e-3  # s, of a finite difference: between samples of the MCS
KNOWN = 0.3  # of the prior's σ: an offset that is told no better is not told


def clock(name, sigma):
    """The Hypothesis of a sensor's offset, s, with the σ of its prior, s."""
    return Hypothesis(
        CLOCK, name, True, (), 1, by_offset, lambda theta, sigma: "", "",
        np.array([sigma]), lambda model, theta, placement: model, moving=True,
        delay=lambda theta, place: theta[0],
    )  # fmt: skip


def by_offset(view):
    """(1, k, n): what a later look at the MCS does to the residuals of a view in motion."""
    return _by_motion(
        view, estimate_state.fit_of(view.setup, view.state, view.group.placement).velocity
    )


def _by_motion(view, velocity):
    """(1, k, n): residuals per second of a body that moves with a right twist (6,), per s."""
    T_body_target = pose_chain.T_body_target(view.setup, view.state, view.group.placement)
    eta = se3.adjoint(se3.inverse(T_body_target)) @ velocity
    ahead = view.changed(T_sensor_target=view.T_sensor_target @ se3.se3_exp(SECOND * eta))
    return (ahead - view.assigned.standard.T)[None] / SECOND


def stream(target):
    """The Hypothesis of how late the clock of a target's poses is against that of the robot's, s,
    where they come by streams of their own: t_robot = t_target + lag."""
    return Hypothesis(
        estimate_state.STREAM, target, False, (), 1, by_lag, lambda theta, sigma: "", "",
        np.array([STREAM_S]), lambda model, theta, placement: model, moving=True,
    )  # fmt: skip


def by_lag(view):
    """(1, k, n): what a later target does to the residuals of a view in motion."""
    place = view.setup.placements[view.group.placement]
    offset, lag = estimate_state.late(view.setup, view.state.theta, place)
    before, after = (place.moving.at(offset, lag + s).T for s in (-LAG_STEP, LAG_STEP))
    return _by_motion(view, se3.se3_log(se3.inverse(before) @ after) / (2 * LAG_STEP))


def streams(setup, result):
    """{target: {value, sigma}} of the lags that were estimated, as far as views in motion tell
    them, s."""
    if result.solution is None:
        return {}
    spread, out = np.diag(result.solution.covariance)[setup.chained :], {}
    for h, at in setup.spans:
        (ratio,) = np.sqrt(spread[at]) if h.name == estimate_state.STREAM else (1.0,)
        if ratio < KNOWN:
            out[h.of] = {
                "value": float(result.state.theta[at][0]),
                "sigma": float(ratio * STREAM_S),
            }
    return out


def doubts(setup, result):
    """As suspicion.suspicions, of every sensor with views in motion: its clock, not to be
    estimated, is off. Mending it moves no pose: that is told by still placements."""
    spread = np.diag(result.solution.covariance)[setup.chained :]
    out = []
    for h, at in setup.spans:
        if h.name != CLOCK:
            continue
        (late,), (sigma,) = result.state.theta[at], np.sqrt(spread[at]) * setup.theta_sigma[at]
        gain = float(score_test.gain(late, sigma))
        out.append(
            {
                "name": CLOCK,
                "of": h.of,
                "text": f"the stamps of {h.of} are {1e3 * abs(late):.3g} ± {1e3 * sigma:.2g} ms "
                f"{'early' if late > 0 else 'late'} against those of the motion capture",
                "remedy": f"write sensors.{h.of}.time_offset_s {1e3 * late:+.3g} ms farther, or "
                "solve.estimate.time_offset: auto",
                "estimate": [float(late)],
                "sigma": [float(sigma)],
                "gain": gain,
                "chance": score_test.chance(gain, 1),
                "explained": {},
                "shift": {n: {"m": 0.0, "rad": 0.0, "sigmas": 0.0} for n in setup.models},
                "rivals": [],
            }
        )
    return out


def told(name, setup, result, guess):
    """{time_offset_s: {value, sigma} or None, clock: what there is to say of it} of a sensor.

    The value is that against its stamps: the first guess, and what was found beside it.
    """
    views = sum(g.moving and g.sensor == name for g in setup.groups)
    at = setup.span(CLOCK, name)
    if not views or at is None or result.solution is None:
        return {"time_offset_s": None, "clock": "not observable: no relative motion"}
    (prior,), (theta,) = setup.theta_sigma[at], result.state.theta[at]
    (ratio,) = np.sqrt(np.diag(result.solution.covariance)[setup.chained :][at])
    if ratio > KNOWN:
        return {
            "time_offset_s": None,
            "clock": f"not observable: {views} views in motion tell it no "
            f"better than ± {1e3 * ratio * prior:.2g} ms",
        }
    value = guess["time_offset_s"]["value"] + theta
    found = {"value": float(value), "sigma": float(ratio * prior)}
    return {"time_offset_s": found, "clock": f"from {views} views of targets in motion"}
