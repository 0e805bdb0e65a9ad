"""Errors against the truth, of one calibration and over several logs."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy import ndarray

from benchmarking.accuracy.accuracy_cases import (
    ACCURACY_ROWS,
    MAX_RMS_RATIO,
    AccuracyCase,
    AccuracyRow,
)
from calib.geometry.se3 import invert_pose, rotation_angle, se3_log


@dataclass(frozen=True)
class CalibrationOutcome:
    """One finished calibration: (mm, deg) of its error, of σ as reported and of the reference;
    NEES/6 is 1 on average where the covariance is honest. reason: why there is no pose, or ""."""

    failure_reason: str
    error: tuple = (np.nan, np.nan)
    sigma: tuple = (np.nan, np.nan)
    nees_ratio: float = np.nan
    reference: tuple = (np.nan, np.nan)
    pixel_error_px: float = (
        np.nan
    )  # error of a corner or contour point per axis at the truth, px, rms


class HasReference(Protocol):
    """A line or statistics with the reference accuracy, (mm, deg)."""

    @property
    def reference(self) -> tuple[float, float]: ...


@dataclass(frozen=True)
class AccuracyLine:
    """One line of the table: a row, N and method over its logs.

    error, sigma, reference: (mm, deg), root mean square over the logs; worst: the largest error
    over its own log's reference, of mm and deg; pixels: as of an Outcome, mean; lost: reasons of
    the logs without a pose.
    """

    row: AccuracyRow
    n_placements: int
    method: str
    n_logs: int
    error: tuple[float, float]
    sigma: tuple[float, float]
    reference: tuple[float, float]
    mean_nees: float
    worst_error_ratio: float
    pixel_error_px: float
    failure_reasons: tuple[str, ...]


def compute_pose_error(T_true: np.ndarray, T_found: np.ndarray) -> tuple[float, float]:
    """(mm, deg): the norm of the difference in translation, the geodesic angle in rotation."""
    shift = np.linalg.norm(T_found[:3, 3] - T_true[:3, 3])
    return 1e3 * float(shift), float(np.degrees(rotation_angle(invert_pose(T_true) @ T_found)))


def sigma_mm_deg(covariance: ndarray) -> tuple[float, float]:
    """(mm, deg) of a covariance (6, 6): square roots of the traces of its two blocks."""
    shift, turn = (np.sqrt(np.trace(covariance[b, b])) for b in (np.s_[:3], np.s_[3:]))
    return 1e3 * float(shift), float(np.degrees(turn))


def compute_nees(T_true: ndarray, T_found: ndarray, covariance: ndarray) -> float:
    """Normalised estimation error squared over its six degrees of freedom."""
    xi = se3_log(invert_pose(T_found) @ T_true)
    return float(xi @ np.linalg.solve(covariance, xi)) / 6


def evaluate_sensor_result(
    sensor_result: dict[str, Any],
    T_true: np.ndarray,
    reference: tuple[float, float],
    pixel_error_px: float,
) -> CalibrationOutcome:
    """The Outcome of one sensor of calibration.json; reference: (mm, deg) of the data."""
    if sensor_result["T_robot_sensor"] is None:
        return CalibrationOutcome(sensor_result["status"]["reason"])
    T = np.array(sensor_result["T_robot_sensor"]["matrix"])
    covariance = np.array(sensor_result["covariance"])
    found = (
        compute_pose_error(T_true, T),
        sigma_mm_deg(covariance),
        compute_nees(T_true, T, covariance),
    )
    return CalibrationOutcome("", *found, reference, pixel_error_px)


def summarize_logs(
    row: AccuracyRow, n_placements: int, method: str, outcomes: list[CalibrationOutcome]
) -> AccuracyLine:
    """The Line over the Outcomes of one row, N and method."""
    good = [o for o in outcomes if not o.failure_reason]
    lost = tuple(o.failure_reason for o in outcomes if o.failure_reason)
    if not good:
        none = (np.nan, np.nan)
        return AccuracyLine(
            row, n_placements, method, 0, none, none, none, np.nan, np.nan, np.nan, lost
        )
    rms = {k: _rms([getattr(o, k) for o in good]) for k in ("error", "sigma", "reference")}
    with np.errstate(divide="ignore", invalid="ignore"):
        worst = max(float(np.max(np.divide(o.error, o.reference))) for o in good)
    return AccuracyLine(
        row=row,
        n_placements=n_placements,
        method=method,
        n_logs=len(good),
        **rms,
        mean_nees=float(np.mean([o.nees_ratio for o in good])),
        worst_error_ratio=worst,
        pixel_error_px=float(np.mean([o.pixel_error_px for o in good])),
        failure_reasons=lost,
    )


def _rms(
    pairs: list[tuple[float, int] | tuple[float, float] | tuple[int, int]],
) -> tuple[float, float]:
    first, second = np.sqrt(np.mean(np.square(pairs), axis=0)).tolist()
    return first, second


def find_accuracy_goal(
    row: AccuracyRow, n_placements: int, statistics: HasReference
) -> tuple[float, float]:
    """(mm, deg) that a row is held to at N: its own, or a multiple of the reference found."""
    if row.goals:
        return row.goals[n_placements]
    mm, deg = statistics.reference
    return MAX_RMS_RATIO * mm, MAX_RMS_RATIO * deg


def summarize_outcomes(outcomes: dict[AccuracyCase, CalibrationOutcome]) -> list[AccuracyLine]:
    """The Lines of {case: Outcome}, in the order of the cases."""
    grouped: dict[tuple[str, int, str], list[AccuracyCase]] = {}
    for case in sorted(outcomes, key=_case_order):
        grouped.setdefault((case.row.key, case.n_placements, case.method), []).append(case)
    return [
        summarize_logs(
            found[0].row, found[0].n_placements, found[0].method, [outcomes[case] for case in found]
        )
        for found in grouped.values()
    ]


def _case_order(case: AccuracyCase) -> tuple[int, int, int, int]:
    keys = [row.key for row in ACCURACY_ROWS]
    return (
        keys.index(case.row.key),
        -case.n_placements,
        case.row.methods.index(case.method),
        case.seed,
    )
