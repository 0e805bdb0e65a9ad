"""What else must be estimated, because the residuals ask for it."""

from dataclasses import replace

from calib.diagnosis.consider_covariance import with_consider_covariance
from calib.diagnosis.leave_one_out import leave_one_out_rms
from calib.diagnosis.suspected_errors import find_suspected_errors
from calib.estimation.corrections.base import ModelCorrection
from calib.estimation.corrections.camera_intrinsics import (
    INTRINSICS,
    find_unobservable_intrinsics,
    make_intrinsics_correction,
)
from calib.estimation.corrections.clock_drift import add_clock_drifts
from calib.estimation.corrections.clock_offset import (
    make_stream_lag_correction,
    stream_lags_json,
    suspected_clock_errors_json,
)
from calib.estimation.corrections.correction_catalog import (
    list_corrections_and_shifts,
    list_testable_corrections,
)
from calib.estimation.corrections.correction_estimate import correction_estimates
from calib.estimation.corrections.lidar_range_errors import BEAM_RANGES, RANGE_BIAS
from calib.estimation.corrections.score_test import gain_p_value, likelihood_gain
from calib.estimation.solver import continue_estimate, estimate_poses

P_ACCEPT = (
    1e-5  # chance of so good an explanation where nothing is wrong, below which it is taken in
)
P_ACCEPT_LIKELY = 1e-3  # the same of what is likely beforehand
MAX_ROUNDS = 4  # times that something is taken in
CORRECTIONS_BY_KEY = {  # of hypotheses, by key of solve.estimate
    "lidar_corrections": ("beam_offsets", "range_bias", "beam_width", "outline_vs_surface"),
    "target_alignment": ("mount",),
}


def estimate_with_corrections(setup, T_robot_sensor, estimate_options, add_moving=None, **limits):
    """(Setup, its Result, its suspicions): as estimation.estimate, and again with the numbers of
    every accepted Hypothesis that can be estimated and that `wanted` names, until none is new.

    estimate_options: solve.estimate of the config. Numbers that nothing asks for stay out: where the data
    tell them badly they would only widen the σ of the poses. A target's place in its body is
    estimated only where that makes placements left out agree better with the others.

    add_moving: Setup -> the one with views of targets in motion too. They tell clocks, and little of
    all else: they come in when that is settled. Where clocks are not to be estimated, they only
    say whether that may be. Suspicions are of the still placements.
    """
    setup = _add_requested_corrections(setup, estimate_options)
    result = estimate_poses(setup, T_robot_sensor, **limits)
    refused = find_unobservable_intrinsics(setup, result) if result.solve_result else {}
    if refused:
        kept = [h for h in setup.corrections if h.name != INTRINSICS or h.subject not in refused]
        setup = replace(
            setup,
            corrections=tuple(kept),
            estimable_intrinsics=setup.estimable_intrinsics | refused,
        )
        result = estimate_poses(setup, T_robot_sensor, **limits)
    setup, result = _add_supported_corrections(setup, result, estimate_options, limits)
    suspected = find_suspected_errors(setup, result, list_corrections_and_shifts(setup))
    wider = add_moving(setup) if add_moving and result.solve_result else setup
    if wider.n_still == len(wider.placements):
        return setup, with_consider_covariance(setup, result), suspected
    with_clocks = continue_estimate(wider, (setup, result), **limits)
    if estimate_options.get("time_offset") is False:
        doubts = suspected_clock_errors_json(wider, with_clocks)
        return setup, with_consider_covariance(setup, result), suspected + doubts
    wider, result = _add_stream_lags(wider, with_clocks, limits)
    setup = add_clock_drifts(wider, result)
    if setup is not wider:
        result = continue_estimate(setup, (wider, result), **limits)
    return setup, with_consider_covariance(setup, result), suspected


def _add_stream_lags(setup, result, limits):
    """(Setup, its Result) with the lags of targets whose poses come by streams of their own, as far
    as they are beyond doubt."""
    places = setup.placements[setup.n_still :]
    targets = sorted({p.target for p in places if p.moving_view.separate_trajectories})
    while targets:
        corrections = (*setup.corrections, *map(make_stream_lag_correction, targets))
        wider = replace(setup, corrections=corrections)
        found = continue_estimate(wider, (setup, result), **limits)
        told = stream_lags_json(wider, found)
        sure = [t for t, lag in told.items() if gain_p_value(likelihood_gain(**lag), 1) < P_ACCEPT]
        if sure == targets:
            return wider, found
        targets = sure
    return setup, result


def _add_supported_corrections(setup, result, wanted, limits):
    """(Setup, its Result) with what the residuals ask for."""
    names = {
        n
        for key, value in wanted.items()
        if value == "auto"
        for n in CORRECTIONS_BY_KEY.get(key, ())
    }
    suspected = find_suspected_errors(setup, result, list_testable_corrections(setup))
    for _ in range(MAX_ROUNDS):
        wider = _with_accepted_corrections(setup, suspected, names)
        if wider is setup:
            break
        found = continue_estimate(wider, (setup, result), **limits)
        pairs = (wider, found), (setup, result)
        errors = [
            leave_one_out_rms(*p)
            for p in pairs
            if len(wider.initial_mounts) > len(setup.initial_mounts)
        ]
        if errors and errors[0] > errors[1]:
            names -= {"mount"}
            continue
        setup, result = wider, found
        suspected = find_suspected_errors(setup, result, list_testable_corrections(setup))
    return setup, result


def _add_requested_corrections(setup, wanted):
    """The Setup with what is to be estimated whatever the residuals say."""
    if wanted.get("target_alignment") is True:
        first = {p.target: p.T_body_target for p in reversed(setup.placements)}
        named = {n: T for n, T in first.items() if n in setup.mount_sigma}
        setup = replace(setup, initial_mounts=named | setup.initial_mounts)
    if wanted.get("intrinsics") is True:
        lenses = [
            make_intrinsics_correction(n, setup.models[n], int(count))
            for n, count in sorted(setup.estimable_intrinsics.items())
        ]
        setup = replace(setup, corrections=(*setup.corrections, *lenses), estimable_intrinsics={})
    return setup


def _with_accepted_corrections(setup, suspected, names):
    """The Setup with what is suspected beyond doubt, and may be estimated, among its unknowns."""
    known = {
        (s["name"], s["subject"]) for s in suspected if s["p_value"] < _acceptance_p_value(setup, s)
    }
    for h in list_testable_corrections(setup):
        if h.name in names and (h.name, h.subject) in known:
            setup = h.add_to_setup(setup) or setup
    return setup


def _acceptance_p_value(setup, suspected):
    """Chance below which something is taken in: of lidars whose beams err one by one, that all of
    them do is likely beforehand."""
    beams = setup.correction_slice(BEAM_RANGES, suspected["subject"]) is not None
    return P_ACCEPT_LIKELY if suspected["name"] == RANGE_BIAS and beams else P_ACCEPT


def sensor_corrections_json(setup, result, sensor):
    """[{name, description, remedy, estimate, sigma, prior_sigma}] of what was estimated of a sensor beside its
    pose: numbers θ in m, rad, their σ and that of their priors."""
    return [
        {
            "name": e.correction.name,
            "description": e.correction.describe(e.values, e.sigma),
            "remedy": e.correction.remedy,
            "estimate": e.values.tolist(),
            "sigma": e.sigma.tolist(),
            "prior_sigma": e.correction.prior_sigma.tolist(),
        }
        for e in correction_estimates(setup, result)
        if isinstance(e.correction, ModelCorrection)
        and e.correction.subject == sensor
        and e.correction.name != INTRINSICS
    ]
