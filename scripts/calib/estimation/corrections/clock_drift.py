"""How the offset of a sensor's clock changes: within a session, and from one to the next."""

from dataclasses import replace

import numpy as np
from scipy import stats

from calib.estimation.corrections.clock_offset import TIME_OFFSET, time_offset_derivative
from calib.estimation.corrections.correction import Correction
from calib.geometry.units import NS_PER_S

CLOCK_DRIFT = "clock_drift"  # name of the correction
SESSION_OFFSET_PRIOR_S, DRIFT_PRIOR_S_PER_S = (
    0.05,
    1e-3,
)  # σ of the priors: from the first session, s, and within one, s per s
P_ACCEPT_DRIFT = 1e-5  # chance of such a wander where there is none, below which it is estimated


def make_clock_drift_correction(sensor, mid_times):
    """The Hypothesis of the drift of a sensor's offset in every session, s per s, and of how much
    larger it is in the middle of those after the first, s; mid_times: [(session, ns)] in order."""
    sigma = np.repeat(
        [DRIFT_PRIOR_S_PER_S, SESSION_OFFSET_PRIOR_S], [len(mid_times), len(mid_times) - 1]
    )
    return Correction(
        CLOCK_DRIFT, sensor, True, (), len(sigma), lambda view: _drift_derivative(view, mid_times),
        lambda theta, sigma: "", "", sigma, lambda model, theta, placement: model,
        is_moving_only=True, clock_delay=lambda theta, place: _drift_weights(place, mid_times) @ theta,
    )  # fmt: skip


def _drift_weights(place, middles):
    """(2 s - 1,): of the numbers of s sessions, in the offset at a view in motion."""
    own = np.array([session == place.session for session, _ in middles], float)
    since = np.array([(place.moving_view.stamp_ns - middle) / NS_PER_S for _, middle in middles])
    return np.concatenate([own * since, own[1:]])


def _drift_derivative(view, middles):
    place = view.setup.placements[view.group.placement]
    return _drift_weights(place, middles)[:, None, None] * time_offset_derivative(view)


def offset_residuals(setup, result, sensor):
    """Of a sensor's views in motion: their Placements, by how much its clock is then behind that of
    the MCS beyond what was estimated (n,), s, and the σ of that (n,), all poses held."""
    span = setup.correction_slice(TIME_OFFSET, sensor)
    (number,), (scale,) = (
        np.arange(setup.n_unknowns)[setup.n_chain_unknowns :][span],
        setup.correction_sigma[span],
    )
    places, seconds, sigma = [], [], []
    for g, part in zip(setup.groups, result.solve_result.factors, strict=True):
        if g.is_moving and g.sensor == sensor:
            i = int(np.flatnonzero(part.columns[-len(part.J_theta) :] == number)[0])
            K, s = part.theta_system
            if K[i, i] > 0:
                places.append(setup.placements[g.placement])
                seconds.append(-scale * s[i] / K[i, i])
                sigma.append(scale / np.sqrt(K[i, i]))
    return places, np.array(seconds), np.array(sigma)


def add_clock_drifts(setup, result):
    """The Setup in which clocks that wander beyond doubt may do so; the same one without any."""
    more = []
    for h in setup.corrections:
        if h.name == TIME_OFFSET and setup.correction_slice(CLOCK_DRIFT, h.subject) is None:
            places, seconds, sigma = offset_residuals(setup, result, h.subject)
            if places and _drift_p_value(places, seconds, sigma) < P_ACCEPT_DRIFT:
                more.append(make_clock_drift_correction(h.subject, _session_mid_times(places)))
    return replace(setup, corrections=(*setup.corrections, *more)) if more else setup


def _session_mid_times(places):
    """[(session, middle of its views in time, ns)]."""
    t = {
        p.session: [q.moving_view.stamp_ns for q in places if q.session == p.session]
        for p in places
    }
    return [(s, (min(v) + max(v)) // 2) for s, v in sorted(t.items())]


def _drift_p_value(places, seconds, sigma):
    """Of as much as drifts and offsets of the sessions explain, where nothing wanders.

    Views that scatter by more than their σ, as where the noise of the MCS is not white, tell less.
    """
    middles = _session_mid_times(places)
    A = np.stack([[1.0, *_drift_weights(p, middles)] for p in places]) / sigma[:, None]
    ratio = seconds / sigma
    left = ratio - A @ np.linalg.lstsq(A, ratio, rcond=1e-9)[0]
    common = ratio - A[:, :1] @ np.linalg.lstsq(A[:, :1], ratio, rcond=1e-9)[0]
    count = A.shape[1] - 1
    scatter = max(1.0, np.sum(left**2) / max(1, len(ratio) - count - 1))
    return stats.chi2.sf((np.sum(common**2) - np.sum(left**2)) / scatter, count)


def clock_drift_json(sensor, setup, result, guess):
    """{session: {time_offset_s, drift_ppm, each {value, sigma}}} of a sensor whose clock wanders,
    its offset in the middle of the session; None of another."""
    at = setup.correction_slice(CLOCK_DRIFT, sensor)
    if at is None or result.solve_result is None:
        return None
    own = np.r_[setup.correction_slice(TIME_OFFSET, sensor), at]
    spread = result.solve_result.covariance[setup.n_chain_unknowns :, setup.n_chain_unknowns :]
    sigma, theta = setup.correction_sigma[own], result.state.correction_values[own]
    spread = spread[np.ix_(own, own)] * np.outer(sigma, sigma)
    moving = [p for p in setup.placements[setup.n_still :] if p.moving_view.sensor == sensor]
    middles, out = _session_mid_times(moving), {}
    for i, (session, _) in enumerate(middles):
        drift, offset = np.zeros(len(own)), np.zeros(len(own))
        drift[1 + i], offset[0] = 1e6, 1
        if i:
            offset[len(middles) + i] = 1
        first = guess["time_offset_s"]["value"]
        out[session] = {
            "time_offset_s": _weighted_sum_json(offset, theta, spread, first),
            "drift_ppm": _weighted_sum_json(drift, theta, spread, 0.0),
        }
    return out


def _weighted_sum_json(weights, theta, spread, start):
    """A sum of numbers of covariance spread, with its σ."""
    sigma = np.sqrt(weights @ spread @ weights)
    return {"value": float(start + weights @ theta), "sigma": float(sigma)}
