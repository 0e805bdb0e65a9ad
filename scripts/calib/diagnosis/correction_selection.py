"""Model selection: estimate the corrections that the residuals support, besides the poses."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from calib.diagnosis.covariance.cluster_covariance import with_reported_covariance
from calib.diagnosis.leave_one_out import leave_one_out_rms
from calib.diagnosis.suspected_errors import find_suspected_errors
from calib.estimation.corrections.base import ModelCorrection
from calib.estimation.corrections.board_shape import BOARD_SHAPE
from calib.estimation.corrections.camera.camera_intrinsics import (
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
from calib.estimation.corrections.lidar.lidar_range_errors import BEAM_RANGES, RANGE_BIAS
from calib.estimation.corrections.mocap.mocap_scale import make_scale_corrections
from calib.estimation.corrections.score_test import gain_p_value, likelihood_gain
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.pose_chain import MOCAP_SCALE
from calib.estimation.solver import continue_estimate, estimate_poses
from calib.sensors.camera.camera_model import CameraModel

MOUNT = "mount"  # name of the correction of T_body_target
P_ACCEPT = 1e-5  # p-value below which a correction is estimated
P_ACCEPT_LIKELY = 1e-3  # the same for a correction that is likely beforehand
MAX_ROUNDS = 4  # of accepting corrections
CORRECTIONS_BY_KEY = {  # names of corrections by key of solve.estimate
    "lidar_corrections": ("beam_offsets", "range_bias", "dark_ranges")
    + ("beam_width", "outline_vs_surface"),
    "target_alignment": (MOUNT,),
    "board_shape": (BOARD_SHAPE,),
    "mocap_scale": (MOCAP_SCALE,),
}


def estimate_with_corrections(
    setup: Setup,
    T_robot_sensor: dict[str, np.ndarray],
    estimate_options: dict[str, Any],
    add_moving: Callable[[Setup], Setup] | None = None,
    **limits: Any,
) -> tuple[Setup, EstimationResult, list[dict[str, Any]]]:
    """Estimate poses and the corrections that the residuals support.

    Returns the setup with these corrections, its result, and the suspected errors of the still
    placements. limits: of estimate_poses. estimate_options: solve.estimate of the config.

    Corrections without support are not estimated, as they would increase the σ of the poses. A
    T_body_target is estimated only if this decreases the leave-one-out error.

    add_moving: adds moving views to a setup. They constrain time offsets and little else, so they
    are added last. If time offsets are not estimated, they only show whether one is wrong.
    """
    setup, result = select_corrections(setup, T_robot_sensor, estimate_options, **limits)
    suspected = find_suspected_errors(setup, result, list_corrections_and_shifts(setup))
    wider = add_moving(setup) if add_moving and result.solve_result else setup
    if wider.n_still == len(wider.placements):
        return setup, with_reported_covariance(setup, result), suspected
    moving_result = continue_estimate(wider, (setup, result), **limits)
    if estimate_options.get("time_offset") is False:
        clock_errors = suspected_clock_errors_json(wider, moving_result)
        return setup, with_reported_covariance(setup, result), suspected + clock_errors
    wider, result = _add_stream_lags(wider, moving_result, limits)
    setup = add_clock_drifts(wider, result)
    if setup is not wider:
        result = continue_estimate(setup, (wider, result), **limits)
    return setup, with_reported_covariance(setup, result), suspected


def select_corrections(
    setup: Setup,
    T_robot_sensor: dict[str, np.ndarray],
    estimate_options: dict[str, Any],
    **limits: Any,
) -> tuple[Setup, EstimationResult]:
    """Estimate still placements with the corrections that are requested or that they support."""
    setup = with_requested_corrections(setup, estimate_options)
    setup, result = _estimate_observable_intrinsics(setup, T_robot_sensor, limits)
    return _add_supported_corrections(setup, result, estimate_options, limits)


def with_requested_corrections(setup: Setup, estimate_options: dict[str, Any]) -> Setup:
    """Add what is estimated in any case: mounts and intrinsics with the value true."""
    if estimate_options.get("target_alignment") is True:
        first = {p.target: p.T_body_target for p in reversed(setup.placements)}
        mounts = {n: T for n, T in first.items() if n in setup.mount_sigma}
        setup = replace(setup, initial_mounts=mounts | setup.initial_mounts)
    if estimate_options.get("mocap_scale") is True:
        for scale in make_scale_corrections(setup):
            setup = scale.add_to_setup(setup) or setup
    if estimate_options.get("intrinsics") is True:
        cameras = {n: m for n, m in setup.models.items() if isinstance(m, CameraModel)}
        intrinsics = [
            make_intrinsics_correction(n, cameras[n], int(count))
            for n, count in sorted(setup.estimable_intrinsics.items())
        ]
        corrections = (*setup.corrections, *intrinsics)
        setup = replace(setup, corrections=corrections, estimable_intrinsics={})
    return setup


def list_adopted_corrections(before: Setup, after: Setup) -> frozenset[tuple[str, str]]:
    """Return (name, subject) of what a Setup estimates and an earlier one did not; mounts too."""
    known, now = (
        {(c.name, c.subject) for c in setup.corrections}
        | {(MOUNT, target) for target in setup.initial_mounts}
        for setup in (before, after)
    )
    return frozenset(now - known)


def _estimate_observable_intrinsics(
    setup: Setup, T_robot_sensor: dict[str, np.ndarray], limits: dict[str, Any]
) -> tuple[Setup, EstimationResult]:
    """Estimate, and again without the intrinsics that the views do not constrain, if any."""
    result = estimate_poses(setup, T_robot_sensor, **limits)
    refused = find_unobservable_intrinsics(setup, result) if result.solve_result else {}
    if not refused:
        return setup, result
    kept = [c for c in setup.corrections if c.name != INTRINSICS or c.subject not in refused]
    setup = replace(
        setup,
        corrections=tuple(kept),
        estimable_intrinsics={**setup.estimable_intrinsics, **refused},
    )
    return setup, estimate_poses(setup, T_robot_sensor, **limits)


def _add_supported_corrections(
    setup: Setup,
    result: EstimationResult,
    estimate_options: dict[str, Any],
    limits: dict[str, Any],
) -> tuple[Setup, EstimationResult]:
    """Estimate also the corrections with value auto that the residuals support."""
    names = {
        name
        for key, value in estimate_options.items()
        if value == "auto"
        for name in CORRECTIONS_BY_KEY.get(key, ())
    }
    suspected = find_suspected_errors(setup, result, list_testable_corrections(setup))
    for _ in range(MAX_ROUNDS):
        wider = _with_accepted_corrections(setup, suspected, names)
        if wider is setup:
            break
        wider_result = continue_estimate(wider, (setup, result), **limits)
        frees_mount = len(wider.initial_mounts) > len(setup.initial_mounts)
        if frees_mount and (
            leave_one_out_rms(wider, wider_result) > leave_one_out_rms(setup, result)
        ):
            names -= {MOUNT}
            continue
        setup, result = wider, wider_result
        suspected = find_suspected_errors(setup, result, list_testable_corrections(setup))
    return setup, result


def _with_accepted_corrections(
    setup: Setup, suspected: list[dict[str, Any]], names: set[str]
) -> Setup:
    """Add the corrections, of those named, that are suspected beyond doubt."""
    accepted = {
        (e["name"], e["subject"]): _lead_over_rivals(e)
        for e in suspected
        if e["p_value"] < _max_p_value(setup, e)
    }
    for correction in list_testable_corrections(setup):
        lead = accepted.get((correction.name, correction.subject), -np.inf)
        if correction.name in names and lead > correction.min_lead:
            setup = correction.add_to_setup(setup) or setup
    return setup


def _lead_over_rivals(error: dict[str, Any]) -> float:
    """Return how far, in log likelihood, a suspected error is ahead of what would do instead."""
    gain = error["log_likelihood_gain"]
    return gain - max((a["log_likelihood_gain"] for a in error["alternatives"]), default=gain / 2)


def _max_p_value(setup: Setup, error: dict[str, Any]) -> float:
    """Return the p-value below which a suspected error is estimated.

    If single beams of a lidar have errors, a common one is likely beforehand.
    """
    has_beam_errors = setup.correction_slice(BEAM_RANGES, error["subject"]) is not None
    return P_ACCEPT_LIKELY if error["name"] == RANGE_BIAS and has_beam_errors else P_ACCEPT


def _add_stream_lags(
    setup: Setup, result: EstimationResult, limits: dict[str, Any]
) -> tuple[Setup, EstimationResult]:
    """Estimate also the significant lags of targets whose poses come in separate streams."""
    moving = setup.placements[setup.n_still :]
    targets = sorted(
        {p.target for p in moving if p.moving_view and p.moving_view.separate_trajectories}
    )
    while targets:
        lags = map(make_stream_lag_correction, targets)
        wider = replace(setup, corrections=(*setup.corrections, *lags))
        wider_result = continue_estimate(wider, (setup, result), **limits)
        significant = [
            target
            for target, lag in stream_lags_json(wider, wider_result).items()
            if gain_p_value(likelihood_gain(**lag), 1) < P_ACCEPT
        ]
        if significant == targets:
            return wider, wider_result
        targets = significant
    return setup, result


def sensor_corrections_json(
    setup: Setup, result: EstimationResult, sensor: str
) -> list[dict[str, Any]]:
    """Return the estimated corrections of a sensor model, with σ and that of the prior.

    [{name, description, remedy, estimate, sigma, prior_sigma}], in m and rad.
    """
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
