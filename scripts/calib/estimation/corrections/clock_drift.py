"""How the time offset of a sensor changes: within a session, and from one session to the next."""

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from calib.estimation.corrections.base import ClockCorrection
from calib.estimation.corrections.clock_offset import (
    TIME_OFFSET,
    moving_view_of,
    time_offset_derivative,
)
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.estimation_problem import Placement, Setup
from calib.estimation.estimation_result import EstimationResult
from calib.geometry.units import MS_PER_S, NS_PER_S

CLOCK_DRIFT = "clock_drift"  # name of the correction
SESSION_OFFSET_PRIOR_S = 0.05  # σ of the prior of the change since the first session
DRIFT_PRIOR_S_PER_S = 1e-3  # σ of the prior of the drift within a session
P_ACCEPT_DRIFT = 1e-5  # a drift is estimated if its p-value is below
PPM = 1e6


class SessionMidTime(NamedTuple):
    """The middle, ns, of the time in which a sensor has moving views in a session."""

    session: str
    stamp_ns: int


class OffsetResiduals(NamedTuple):
    """The n moving views of a sensor, the remaining time offset (n,) in each, and its σ (n,)."""

    placements: list[Placement]
    offset_s: np.ndarray
    sigma_s: np.ndarray


@dataclass(frozen=True)
class ClockDriftCorrection(ClockCorrection):
    """Drifts (s,) of a time offset in s sessions, s per s, and how much larger the offset is in the
    middle of the sessions after the first (s - 1,), s. mid_times: of the sessions, in order."""

    name = CLOCK_DRIFT
    mid_times: tuple[SessionMidTime, ...] = field(repr=False)

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        place = linearization.setup.placements[linearization.group.placement]
        weights = _drift_weights(place, self.mid_times)
        return weights[:, None, None] * time_offset_derivative(linearization)

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        n = len(self.mid_times)
        offsets = np.append(values[n:], 0.0)
        return (
            f"the clock of {self.subject} drifts by up to {PPM * np.abs(values[:n]).max():.3g} ppm "
            f"and changes by up to {MS_PER_S * np.ptp(offsets):.3g} ms between sessions"
        )

    def delay_s(self, values: np.ndarray, placement: Placement) -> float:
        return _drift_weights(placement, self.mid_times) @ values


def make_clock_drift_correction(
    sensor: str, mid_times: tuple[SessionMidTime, ...]
) -> ClockDriftCorrection:
    """Return the correction of the drift of a sensor's clock in sessions with these mid times."""
    n = len(mid_times)
    sigma = np.repeat([DRIFT_PRIOR_S_PER_S, SESSION_OFFSET_PRIOR_S], [n, n - 1])
    return ClockDriftCorrection(sensor, sigma, mid_times)


def _drift_weights(place: Placement, mid_times: tuple[SessionMidTime, ...]) -> np.ndarray:
    """Return the factors (2 s - 1,) of the values in the time offset of one moving view."""
    own = np.array([session == place.session for session, _ in mid_times], float)
    stamp_ns = moving_view_of(place).stamp_ns
    since = np.array([(stamp_ns - middle) / NS_PER_S for _, middle in mid_times])
    return np.concatenate([own * since, own[1:]])


def offset_residuals(setup: Setup, result: EstimationResult, sensor: str) -> OffsetResiduals:
    """Estimate, from every moving view alone, the time offset beyond the estimated one.

    All poses are fixed. Views that do not constrain the offset are left out.
    """
    if result.solve_result is None:
        return OffsetResiduals([], np.zeros(0), np.zeros(0))
    span = setup.correction_slice(TIME_OFFSET, sensor)
    (column,) = np.arange(setup.n_unknowns)[setup.n_chain_unknowns :][span]
    (scale,) = setup.correction_sigma[span]
    places, seconds, sigma = [], [], []
    for g, factor in zip(setup.groups, result.solve_result.factors, strict=True):
        if g.is_moving and g.sensor == sensor:
            own = factor.columns[-len(factor.J_theta) :]
            i = int(np.flatnonzero(own == column)[0])
            information, gradient = factor.theta_system
            if information[i, i] > 0:
                places.append(setup.placements[g.placement])
                seconds.append(-scale * gradient[i] / information[i, i])
                sigma.append(scale / np.sqrt(information[i, i]))
    return OffsetResiduals(places, np.array(seconds), np.array(sigma))


def add_clock_drifts(setup: Setup, result: EstimationResult) -> Setup:
    """Return the Setup that also estimates the drifts that the moving views show.

    Returns the same Setup if there are none.
    """
    drifts = []
    for correction in setup.corrections:
        sensor = correction.subject
        known = setup.correction_slice(CLOCK_DRIFT, sensor) is not None
        if correction.name == TIME_OFFSET and not known:
            residuals = offset_residuals(setup, result, sensor)
            if residuals.placements and _drift_p_value(residuals) < P_ACCEPT_DRIFT:
                mid_times = _session_mid_times(residuals.placements)
                drifts.append(make_clock_drift_correction(sensor, mid_times))
    return replace(setup, corrections=(*setup.corrections, *drifts)) if drifts else setup


def _session_mid_times(placements: list[Placement]) -> tuple[SessionMidTime, ...]:
    """Return the middle of the views of every session, sorted by session."""
    stamps: dict[str, list[int]] = {}
    for p in placements:
        stamps.setdefault(p.session, []).append(moving_view_of(p).stamp_ns)
    return tuple(SessionMidTime(s, (min(t) + max(t)) // 2) for s, t in sorted(stamps.items()))


def _drift_p_value(residuals: OffsetResiduals) -> float:
    """Return the p-value of what drifts explain of the offset residuals, if no clock drifts.

    If the residuals scatter by more than their σ, for example because the noise of the MCS is not
    white, they count for less.
    """
    mid_times = _session_mid_times(residuals.placements)
    rows = [[1.0, *_drift_weights(p, mid_times)] for p in residuals.placements]
    A = np.stack(rows) / residuals.sigma_s[:, None]
    ratio = residuals.offset_s / residuals.sigma_s
    with_drift = ratio - A @ np.linalg.lstsq(A, ratio, rcond=1e-9)[0]
    constant = ratio - A[:, :1] @ np.linalg.lstsq(A[:, :1], ratio, rcond=1e-9)[0]
    n_drift_values = A.shape[1] - 1
    scatter = max(1.0, np.sum(with_drift**2) / max(1, len(ratio) - n_drift_values - 1))
    explained = np.sum(constant**2) - np.sum(with_drift**2)
    return stats.chi2.sf(explained / scatter, n_drift_values)


def clock_drift_json(
    sensor: str, setup: Setup, result: EstimationResult, guess: dict[str, Any]
) -> dict[str, Any] | None:
    """Return {session: {time_offset_s, drift_ppm}}, each {value, sigma}; None without a drift.

    time_offset_s: in the middle of the session.
    """
    drift_slice = setup.correction_slice(CLOCK_DRIFT, sensor)
    if drift_slice is None or result.solve_result is None:
        return None
    own = np.r_[setup.correction_slice(TIME_OFFSET, sensor), drift_slice]
    covariance = result.solve_result.covariance[setup.n_chain_unknowns :, setup.n_chain_unknowns :]
    sigma, values = setup.correction_sigma[own], result.state.correction_values[own]
    covariance = covariance[np.ix_(own, own)] * np.outer(sigma, sigma)
    moving = [p for p in setup.placements[setup.n_still :] if moving_view_of(p).sensor == sensor]
    mid_times, out = _session_mid_times(moving), {}
    for i, (session, _) in enumerate(mid_times):
        drift, offset = np.zeros(len(own)), np.zeros(len(own))
        drift[1 + i], offset[0] = PPM, 1
        if i:
            offset[len(mid_times) + i] = 1
        first = guess["time_offset_s"]["value"]
        out[session] = {
            "time_offset_s": _weighted_sum_json(offset, values, covariance, first),
            "drift_ppm": _weighted_sum_json(drift, values, covariance, 0.0),
        }
    return out


def _weighted_sum_json(
    weights: np.ndarray, values: np.ndarray, covariance: np.ndarray, start: float
) -> dict[str, float]:
    """Return start + weights (q,) · values (q,), with its σ."""
    sigma = np.sqrt(weights @ covariance @ weights)
    return {"value": float(start + weights @ values), "sigma": float(sigma)}
