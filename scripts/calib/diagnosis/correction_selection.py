"""Model selection: estimate the corrections that the residuals support, besides the poses."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from calib.diagnosis.covariance.cluster_covariance import with_reported_covariance
from calib.diagnosis.error_search.supported_corrections import (
    MOUNT,
    P_ACCEPT,
    Choice,
    Choices,
    list_adopted_corrections,
    select_corrections,
    with_requested_corrections,
)
from calib.diagnosis.split_halves import (
    MIN_HALF_PLACEMENTS,
    HalfEstimate,
    count_placements,
    estimate_halves,
)
from calib.diagnosis.suspected_errors import find_suspected_errors
from calib.estimation.corrections.base import ModelCorrection
from calib.estimation.corrections.camera.camera_intrinsics import INTRINSICS
from calib.estimation.corrections.clock_drift import add_clock_drifts
from calib.estimation.corrections.clock_offset import (
    make_stream_lag_correction,
    stream_lags_json,
    suspected_clock_errors_json,
)
from calib.estimation.corrections.correction_catalog import list_corrections_and_shifts
from calib.estimation.corrections.correction_estimate import correction_estimates
from calib.estimation.corrections.score_test import gain_p_value, likelihood_gain
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.solver import continue_estimate

Halves: TypeAlias = tuple[HalfEstimate, HalfEstimate]


def estimate_with_corrections(
    setup: Setup,
    T_robot_sensor: dict[str, np.ndarray],
    estimate_options: dict[str, Any],
    add_moving: Callable[[Setup], Setup] | None = None,
    halves: Halves | None = None,
    **limits: Any,
) -> tuple[Setup, EstimationResult, list[dict[str, Any]]]:
    """Estimate poses and the corrections that the residuals support, in halves of the data too.

    Returns the setup with these corrections, its result, and the suspected errors of the still
    placements. limits: of estimate_poses. estimate_options: solve.estimate of the config.

    Corrections without support are not estimated, as they would increase the σ of the poses. A
    T_body_target is estimated only if this decreases the leave-one-out error. What one half of the
    placements does not adopt by itself stays among the suspected errors, which say so.

    halves: of estimate_halves, where they are there already.

    add_moving: adds moving views to a setup. They constrain time offsets and little else, so they
    are added last. If time offsets are not estimated, they only show whether one is wrong.
    """
    setup, result, check = select_confirmed_corrections(
        setup, T_robot_sensor, estimate_options, halves, **limits
    )
    suspected = find_suspected_errors(setup, result, list_corrections_and_shifts(setup))
    suspected = [check.annotate(error) for error in suspected]
    wider = add_moving(setup) if add_moving and result.solve_result else setup
    if wider.n_still == len(wider.placements):
        return setup, with_reported_covariance(setup, result), suspected
    moving_result = continue_estimate(wider, (setup, result), **limits)
    if estimate_options.get("time_offset") is False:
        suspected += map(check.annotate, suspected_clock_errors_json(wider, moving_result))
        return setup, with_reported_covariance(setup, result), suspected
    wider, result = _add_stream_lags(wider, moving_result, limits)
    setup = add_clock_drifts(wider, result)
    if setup is not wider:
        result = continue_estimate(setup, (wider, result), **limits)
    return setup, with_reported_covariance(setup, result), suspected


@dataclass(frozen=True)
class HalvesCheck:
    """Which corrections all placements adopt, and which each half does.

    in_full: by all placements. halves: None: too few placements for halves, or nothing to check.
    """

    in_full: Choices
    halves: Halves | None

    @property
    def confirmed(self) -> Choices:
        """Return the corrections that both halves adopt, and mounts.

        A mount has a stated prior, and must decrease the leave-one-out error.
        """
        adopted = [half.adopted for half in self.halves or ()]
        mounts = frozenset(choice for choice in self.in_full if choice[0] == MOUNT)
        return mounts | (frozenset.intersection(*adopted) if adopted else frozenset())

    def annotate(self, error: dict[str, Any]) -> dict[str, Any]:
        """Return a suspected error with adopted_in_halves, None where all placements together
        would not estimate it; its description says so if the halves are why it is not estimated."""
        choice = (error["name"], error["subject"])
        if choice not in self.in_full or choice in self.confirmed:
            return error | {"adopted_in_halves": None}
        reason = self._describe_refusal(choice)
        return error | {
            "description": f"{error['description']} (not estimated: {reason})",
            "adopted_in_halves": self._count_halves(choice),
        }

    def _count_halves(self, choice: Choice) -> int | None:
        """Return how many halves adopt a correction; None if they have too few placements of
        its subject."""
        if self.halves is None:
            return None
        counts = [count_placements(half.setup, choice[1]) for half in self.halves]
        if min(counts) < MIN_HALF_PLACEMENTS:
            return None
        return sum(choice in half.adopted for half in self.halves)

    def _describe_refusal(self, choice: Choice) -> str:
        count = self._count_halves(choice)
        if count is None:
            return (
                f"{choice[1]} has fewer than {2 * MIN_HALF_PLACEMENTS} placements, too few to "
                "check it in halves of the data"
            )
        return ("neither half" if count == 0 else "only one half") + " of the data shows it alone"


def select_confirmed_corrections(
    setup: Setup,
    T_robot_sensor: dict[str, np.ndarray],
    estimate_options: dict[str, Any],
    halves: Halves | None = None,
    **limits: Any,
) -> tuple[Setup, EstimationResult, HalvesCheck]:
    """Estimate still placements with the corrections that they and both halves support.

    halves: of estimate_halves, where they are there already. limits: of estimate_poses.
    """
    chosen, result = select_corrections(setup, T_robot_sensor, estimate_options, **limits)
    requested = with_requested_corrections(setup, estimate_options)
    check = HalvesCheck(list_adopted_corrections(requested, chosen), halves)
    if halves is None and not check.in_full <= check.confirmed:
        halves = estimate_halves(setup, T_robot_sensor, estimate_options, **limits)
        check = replace(check, halves=halves)
    if not check.in_full <= check.confirmed:
        chosen, result = select_corrections(
            setup, T_robot_sensor, estimate_options, allowed=check.confirmed, **limits
        )
    return chosen, result, check


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
