"""How the offset of a sensor's clock changes: within a session, and from one to the next."""

from dataclasses import replace

import numpy as np
from scipy import stats

from calib.estimation.corrections import clock_offset
from calib.estimation.corrections.correction import Hypothesis
from calib.mocap.body_trajectory import NS

WANDER = "time_wander"  # name of the correction
OFFSET_S, DRIFT = 0.05, 1e-3  # σ of the priors: from the first session, s, and within one, s per s
SURE = 1e-5  # chance of such a wander where there is none, below which it is estimated


def wander(name, middles):
    """The Hypothesis of the drift of a sensor's offset in every session, s per s, and of how much
    larger it is in the middle of those after the first, s; middles: [(session, ns)] in order."""
    sigma = np.repeat([DRIFT, OFFSET_S], [len(middles), len(middles) - 1])
    return Hypothesis(
        WANDER, name, True, (), len(sigma), lambda view: _by_wander(view, middles),
        lambda theta, sigma: "", "", sigma, lambda model, theta, placement: model,
        moving=True, delay=lambda theta, place: _shares(place, middles) @ theta,
    )  # fmt: skip


def _shares(place, middles):
    """(2 s - 1,): of the numbers of s sessions, in the offset at a view in motion."""
    own = np.array([session == place.session for session, _ in middles], float)
    since = np.array([(place.moving.t - middle) / NS for _, middle in middles])
    return np.concatenate([own * since, own[1:]])


def _by_wander(view, middles):
    place = view.setup.placements[view.group.placement]
    return _shares(place, middles)[:, None, None] * clock_offset.by_offset(view)


def late(setup, result, name):
    """Of a sensor's views in motion: their Placements, by how much its clock is then behind that of
    the MCS beyond what was estimated (n,), s, and the σ of that (n,), all poses held."""
    span = setup.span(clock_offset.CLOCK, name)
    (number,), (scale,) = np.arange(setup.n)[setup.chained :][span], setup.theta_sigma[span]
    places, seconds, sigma = [], [], []
    for g, part in zip(setup.groups, result.solution.parts, strict=True):
        if g.moving and g.sensor == name:
            i = int(np.flatnonzero(part.columns[-len(part.D) :] == number)[0])
            K, s = part.of_theta
            if K[i, i] > 0:
                places.append(setup.placements[g.placement])
                seconds.append(-scale * s[i] / K[i, i])
                sigma.append(scale / np.sqrt(K[i, i]))
    return places, np.array(seconds), np.array(sigma)


def allowed(setup, result):
    """The Setup in which clocks that wander beyond doubt may do so; the same one without any."""
    more = []
    for h in setup.corrections:
        if h.name == clock_offset.CLOCK and setup.span(WANDER, h.of) is None:
            places, seconds, sigma = late(setup, result, h.of)
            if places and _chance(places, seconds, sigma) < SURE:
                more.append(wander(h.of, _middles(places)))
    return replace(setup, corrections=(*setup.corrections, *more)) if more else setup


def _middles(places):
    """[(session, middle of its views in time, ns)]."""
    t = {p.session: [q.moving.t for q in places if q.session == p.session] for p in places}
    return [(s, (min(v) + max(v)) // 2) for s, v in sorted(t.items())]


def _chance(places, seconds, sigma):
    """Of as much as drifts and offsets of the sessions explain, where nothing wanders.

    Views that scatter by more than their σ, as where the noise of the MCS is not white, tell less.
    """
    middles = _middles(places)
    A = np.stack([[1.0, *_shares(p, middles)] for p in places]) / sigma[:, None]
    ratio = seconds / sigma
    left = ratio - A @ np.linalg.lstsq(A, ratio, rcond=1e-9)[0]
    common = ratio - A[:, :1] @ np.linalg.lstsq(A[:, :1], ratio, rcond=1e-9)[0]
    count = A.shape[1] - 1
    scatter = max(1.0, np.sum(left**2) / max(1, len(ratio) - count - 1))
    return stats.chi2.sf((np.sum(common**2) - np.sum(left**2)) / scatter, count)


def told(name, setup, result, guess):
    """{session: {time_offset_s, drift_ppm, each {value, sigma}}} of a sensor whose clock wanders,
    its offset in the middle of the session; None of another."""
    at = setup.span(WANDER, name)
    if at is None or result.solution is None:
        return None
    own = np.r_[setup.span(clock_offset.CLOCK, name), at]
    spread = result.solution.covariance[setup.chained :, setup.chained :]
    sigma, theta = setup.theta_sigma[own], result.state.theta[own]
    spread = spread[np.ix_(own, own)] * np.outer(sigma, sigma)
    moving = [p for p in setup.placements[setup.still :] if p.moving.sensor == name]
    middles, out = _middles(moving), {}
    for i, (session, _) in enumerate(middles):
        drift, offset = np.zeros(len(own)), np.zeros(len(own))
        drift[1 + i], offset[0] = 1e6, 1
        if i:
            offset[len(middles) + i] = 1
        first = guess["time_offset_s"]["value"]
        out[session] = {
            "time_offset_s": _number(offset, theta, spread, first),
            "drift_ppm": _number(drift, theta, spread, 0.0),
        }
    return out


def _number(weights, theta, spread, start):
    """A sum of numbers of covariance spread, with its σ."""
    sigma = np.sqrt(weights @ spread @ weights)
    return {"value": float(start + weights @ theta), "sigma": float(sigma)}
