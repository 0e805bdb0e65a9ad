"""Corrections that the residuals of still placements support are estimated, besides the poses.

The error common to all ranges of a lidar is not among them: its pose takes up such an error, or
causes what looks like one. It is estimated only on request.
"""

from collections.abc import Set
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from calib.diagnosis.leave_one_out import leave_one_out_rms
from calib.diagnosis.suspected_errors import find_suspected_errors
from calib.estimation.corrections.board_shape import BOARD_SHAPE
from calib.estimation.corrections.camera.camera_intrinsics import (
    INTRINSICS,
    find_unobservable_intrinsics,
    make_intrinsics_correction,
)
from calib.estimation.corrections.correction_catalog import list_testable_corrections
from calib.estimation.corrections.lidar.lidar_range_errors import make_range_corrections
from calib.estimation.corrections.mocap.mocap_scale import make_scale_corrections
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.pose_chain import MOCAP_SCALE
from calib.estimation.solver import continue_estimate, estimate_poses
from calib.sensors.camera.camera_model import CameraModel

Choice: TypeAlias = tuple[str, str]  # name and subject of a correction; a mount by its target
Choices: TypeAlias = frozenset[Choice]

MOUNT = "mount"  # name of the correction of T_body_target
P_ACCEPT = 1e-5  # p-value below which a correction is estimated
MAX_ROUNDS = 4  # of accepting corrections
CORRECTIONS_BY_KEY = {  # names of corrections by key of solve.estimate
    "lidar_corrections": (
        "beam_offsets",
        "dark_ranges",
        "intensity_ranges",
        "beam_width",
        "outline_vs_surface",
    ),
    "target_alignment": (MOUNT,),
    "board_shape": (BOARD_SHAPE,),
    "mocap_scale": (MOCAP_SCALE,),
}


@dataclass(frozen=True)
class RequiredSupport:
    """How strongly residuals must support a correction that is estimated.

    max_p_value: by chance. lead_share: of Correction.min_lead, in log likelihood over rivals.
    """

    max_p_value: float
    lead_share: float


BY_ALL_PLACEMENTS = RequiredSupport(max_p_value=P_ACCEPT, lead_share=1.0)
# Both halves together are rarer by chance than P_ACCEPT. A half has half of the log likelihood.
BY_ONE_HALF = RequiredSupport(max_p_value=1e-3, lead_share=0.5)


def select_corrections(
    setup: Setup,
    T_robot_sensor: dict[str, np.ndarray],
    estimate_options: dict[str, Any],
    *,
    allowed: Choices | None = None,
    required: RequiredSupport = BY_ALL_PLACEMENTS,
    **limits: Any,
) -> tuple[Setup, EstimationResult]:
    """Estimate still placements with the corrections that are requested or that they support.

    allowed: the corrections, of those with value auto, that may be estimated; None: all.
    required: of the residuals for a correction with value auto.
    """
    setup = with_requested_corrections(setup, estimate_options)
    setup, result = _estimate_observable_intrinsics(setup, T_robot_sensor, limits)
    names = list_selectable_names(estimate_options)
    choices = {(c.name, c.subject) for c in list_testable_corrections(setup) if c.name in names}
    if allowed is not None:
        choices &= allowed
    return _add_supported_corrections((setup, result), choices, required, limits)


def with_requested_corrections(setup: Setup, estimate_options: dict[str, Any]) -> Setup:
    """Add what is estimated in any case: mounts, intrinsics and range biases with value true."""
    if estimate_options.get("target_alignment") is True:
        first = {p.target: p.T_body_target for p in reversed(setup.placements)}
        mounts = {n: T for n, T in first.items() if n in setup.mount_sigma}
        setup = replace(setup, initial_mounts=mounts | setup.initial_mounts)
    if estimate_options.get("intrinsics") is True:
        cameras = {n: m for n, m in setup.models.items() if isinstance(m, CameraModel)}
        intrinsics = [
            make_intrinsics_correction(n, cameras[n], int(count))
            for n, count in sorted(setup.estimable_intrinsics.items())
        ]
        corrections = (*setup.corrections, *intrinsics)
        setup = replace(setup, corrections=corrections, estimable_intrinsics={})
    if estimate_options.get("mocap_scale") is True:
        for scale in make_scale_corrections(setup):
            setup = scale.add_to_setup(setup) or setup
    if estimate_options.get("range_bias") is True:
        for correction in make_range_corrections(setup):
            setup = correction.add_to_setup(setup) or setup
    return setup


def list_selectable_names(estimate_options: dict[str, Any]) -> frozenset[str]:
    """Return the names of the corrections that are estimated if the residuals support them."""
    return frozenset(
        name
        for key, value in estimate_options.items()
        if value == "auto"
        for name in CORRECTIONS_BY_KEY.get(key, ())
    )


def list_adopted_corrections(before: Setup, after: Setup) -> Choices:
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
    estimate: tuple[Setup, EstimationResult],
    choices: Set[Choice],
    required: RequiredSupport,
    limits: dict[str, Any],
) -> tuple[Setup, EstimationResult]:
    """Estimate also those of some corrections that the residuals support."""
    setup, result = estimate
    suspected = find_suspected_errors(setup, result, list_testable_corrections(setup))
    for _ in range(MAX_ROUNDS):
        wider = _with_corrections(setup, suspected, choices, required)
        if wider is setup:
            break
        wider_result = continue_estimate(wider, (setup, result), **limits)
        frees_mount = len(wider.initial_mounts) > len(setup.initial_mounts)
        if frees_mount and (
            leave_one_out_rms(wider, wider_result) > leave_one_out_rms(setup, result)
        ):
            choices = {(name, subject) for name, subject in choices if name != MOUNT}
            continue
        setup, result = wider, wider_result
        suspected = find_suspected_errors(setup, result, list_testable_corrections(setup))
    return setup, result


def _with_corrections(
    setup: Setup,
    suspected: list[dict[str, Any]],
    choices: Set[Choice],
    required: RequiredSupport,
) -> Setup:
    """Add the suspected corrections, of some choices, that have the required support."""
    leads = {
        (e["name"], e["subject"]): _lead_over_rivals(e)
        for e in suspected
        if e["p_value"] < required.max_p_value
    }
    for correction in list_testable_corrections(setup):
        choice = (correction.name, correction.subject)
        if (
            choice in choices
            and leads.get(choice, -np.inf) > required.lead_share * correction.min_lead
        ):
            setup = correction.add_to_setup(setup) or setup
    return setup


def _lead_over_rivals(error: dict[str, Any]) -> float:
    """Return how far, in log likelihood, a suspected error is ahead of what would do instead."""
    gain = error["log_likelihood_gain"]
    return gain - max((a["log_likelihood_gain"] for a in error["alternatives"]), default=gain / 2)
