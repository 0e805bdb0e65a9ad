"""What else must be estimated, because the residuals ask for it."""

from dataclasses import replace

import numpy as np

from calib.diagnosis import consider_covariance, leave_one_out, suspected_errors
from calib.estimation import solver
from calib.estimation.corrections import (
    camera_intrinsics,
    clock_drift,
    clock_offset,
    correction_catalog,
    score_test,
)

SURE = 1e-5  # chance of so good an explanation where nothing is wrong, below which it is taken in
LIKELY = 1e-3  # the same of what is likely beforehand
MOST = 4  # times that something is taken in
NAMES = {  # of hypotheses, by key of solve.estimate
    "beams": ("beams", "range_bias", "beam_width", "apart"),
    "target_alignment": ("frame",),
}


def estimate(setup, T_robot_sensor, wanted, moving=None, **limits):
    """(Setup, its Result, its suspicions): as estimation.estimate, and again with the numbers of
    every accepted Hypothesis that can be estimated and that `wanted` names, until none is new.

    wanted: solve.estimate of the config. Numbers that nothing asks for stay out: where the data
    tell them badly they would only widen the σ of the poses. A target's place in its body is
    estimated only where that makes placements left out agree better with the others.

    moving: Setup -> the one with views of targets in motion too. They tell clocks, and little of
    all else: they come in when that is settled. Where clocks are not to be estimated, they only
    say whether that may be. Suspicions are of the still placements.
    """
    setup = _from_the_start(setup, wanted)
    result = solver.estimate(setup, T_robot_sensor, **limits)
    refused = camera_intrinsics.refused(setup, result) if result.solution else {}
    if refused:
        kept = [
            h for h in setup.corrections if h.name != camera_intrinsics.NAME or h.of not in refused
        ]
        setup = replace(setup, corrections=tuple(kept), lenses=setup.lenses | refused)
        result = solver.estimate(setup, T_robot_sensor, **limits)
    setup, result = _asked_for(setup, result, wanted, limits)
    suspected = suspected_errors.suspicions(setup, result, correction_catalog.with_moves(setup))
    wider = moving(setup) if moving and result.solution else setup
    if wider.still == len(wider.placements):
        return setup, consider_covariance.widened(setup, result), suspected
    with_clocks = solver.resume(wider, (setup, result), **limits)
    if wanted.get("time_offset") is False:
        doubts = clock_offset.doubts(wider, with_clocks)
        return setup, consider_covariance.widened(setup, result), suspected + doubts
    wider, result = _lags(wider, with_clocks, limits)
    setup = clock_drift.allowed(wider, result)
    if setup is not wider:
        result = solver.resume(setup, (wider, result), **limits)
    return setup, consider_covariance.widened(setup, result), suspected


def _lags(setup, result, limits):
    """(Setup, its Result) with the lags of targets whose poses come by streams of their own, as far
    as they are beyond doubt."""
    places = setup.placements[setup.still :]
    targets = sorted({p.target for p in places if p.moving.apart})
    while targets:
        corrections = (*setup.corrections, *map(clock_offset.stream, targets))
        wider = replace(setup, corrections=corrections)
        found = solver.resume(wider, (setup, result), **limits)
        told = clock_offset.streams(wider, found)
        sure = [t for t, lag in told.items() if score_test.chance(score_test.gain(**lag), 1) < SURE]
        if sure == targets:
            return wider, found
        targets = sure
    return setup, result


def _asked_for(setup, result, wanted, limits):
    """(Setup, its Result) with what the residuals ask for."""
    names = {n for key, value in wanted.items() if value == "auto" for n in NAMES.get(key, ())}
    suspected = suspected_errors.suspicions(setup, result, correction_catalog.all_of(setup))
    for _ in range(MOST):
        wider = _widened(setup, suspected, names)
        if wider is setup:
            break
        found = solver.resume(wider, (setup, result), **limits)
        pairs = (wider, found), (setup, result)
        errors = [leave_one_out.error(*p) for p in pairs if len(wider.mounts) > len(setup.mounts)]
        if errors and errors[0] > errors[1]:
            names -= {"frame"}
            continue
        setup, result = wider, found
        suspected = suspected_errors.suspicions(setup, result, correction_catalog.all_of(setup))
    return setup, result


def _from_the_start(setup, wanted):
    """The Setup with what is to be estimated whatever the residuals say."""
    if wanted.get("target_alignment") is True:
        first = {p.target: p.T_body_target for p in reversed(setup.placements)}
        named = {n: T for n, T in first.items() if n in setup.alignment}
        setup = replace(setup, mounts=named | setup.mounts)
    if wanted.get("intrinsics") is True:
        lenses = [
            camera_intrinsics.lens(n, setup.models[n], int(count))
            for n, count in sorted(setup.lenses.items())
        ]
        setup = replace(setup, corrections=(*setup.corrections, *lenses), lenses={})
    return setup


def _widened(setup, suspected, names):
    """The Setup with what is suspected beyond doubt, and may be estimated, among its unknowns."""
    known = {(s["name"], s["of"]) for s in suspected if s["chance"] < _sure(setup, s)}
    for h in correction_catalog.all_of(setup):
        if h.name in names and (h.name, h.of) in known:
            setup = h.estimated(setup) or setup
    return setup


def _sure(setup, suspected):
    """Chance below which something is taken in: of lidars whose beams err one by one, that all of
    them do is likely beforehand."""
    beams = setup.span("beams", suspected["of"]) is not None
    return LIKELY if suspected["name"] == "range_bias" and beams else SURE


def corrections(setup, result, sensor):
    """[{name, text, remedy, estimate, sigma, prior}] of what was estimated of a sensor beside its
    pose: numbers θ in m, rad, their σ and that of their priors."""
    spread = np.sqrt(np.diag(result.solution.covariance)[setup.chained :])
    ends = np.cumsum([h.size for h in setup.corrections])[:-1]
    parts = (np.split(v, ends) for v in (result.state.theta, spread * setup.theta_sigma))
    out = []
    for h, theta, sigma in zip(setup.corrections, *parts, strict=False):
        told = {"name": h.name, "text": h.told(theta, sigma), "remedy": h.remedy}
        numbers = {"estimate": theta, "sigma": sigma, "prior": h.sigma}
        if h.of == sensor and not (h.moving or h.session) and h.name != camera_intrinsics.NAME:
            out.append(told | {k: v.tolist() for k, v in numbers.items()})
    return out
