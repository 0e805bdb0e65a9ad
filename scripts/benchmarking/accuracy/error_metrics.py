"""Errors of calibrations relative to the truth: of one, and RMS over several logs."""

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
    """Accuracy of one finished calibration.

    failure_reason: why there is no pose, else ""; error, sigma (as reported) and reference: (mm,
    deg); nees_ratio: NEES/6, on average 1 if the covariance is correct; pixel_error_px: RMS error
    of corners or contour points per axis at the true poses.
    """

    failure_reason: str
    error: tuple[float, float] = (np.nan, np.nan)
    sigma: tuple[float, float] = (np.nan, np.nan)
    nees_ratio: float = np.nan
    reference: tuple[float, float] = (np.nan, np.nan)
    pixel_error_px: float = np.nan


class HasReference(Protocol):
    """A table line or statistics with a reference accuracy."""

    @property
    def reference(self) -> tuple[float, float]:
        """The reference accuracy, (mm, deg)."""


@dataclass(frozen=True)
class AccuracyLine:
    """One printed line of the table: a row at one number of placements by one method.

    error, sigma, reference: (mm, deg), RMS over the logs; mean_nees: mean of NEES/6;
    worst_error_ratio: largest error of a log over its reference, in mm or deg; pixel_error_px: mean
    over the logs; failure_reasons: of the logs without a pose.
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
    """Return (mm, deg): norm of the translation error and geodesic angle of the rotation error."""
    shift = np.linalg.norm(T_found[:3, 3] - T_true[:3, 3])
    return 1e3 * float(shift), float(np.degrees(rotation_angle(invert_pose(T_true) @ T_found)))


def sigma_mm_deg(covariance: ndarray) -> tuple[float, float]:
    """Return (mm, deg) of a covariance (6, 6): square roots of the traces of its two blocks."""
    shift, turn = (np.sqrt(np.trace(covariance[b, b])) for b in (np.s_[:3], np.s_[3:]))
    return 1e3 * float(shift), float(np.degrees(turn))


def compute_nees(T_true: ndarray, T_found: ndarray, covariance: ndarray) -> float:
    """Return the normalised estimation error squared (NEES) over its six degrees of freedom."""
    xi = se3_log(invert_pose(T_found) @ T_true)
    return float(xi @ np.linalg.solve(covariance, xi)) / 6


def evaluate_sensor_result(
    sensor_result: dict[str, Any],
    T_true: np.ndarray,
    reference: tuple[float, float],
    pixel_error_px: float,
) -> CalibrationOutcome:
    """Compare one sensor of calibration.json with its true pose.

    reference: reference accuracy of its data, (mm, deg).
    """
    if sensor_result["T_robot_sensor"] is None:
        return CalibrationOutcome(sensor_result["status"]["reason"])
    T = np.array(sensor_result["T_robot_sensor"]["matrix"])
    covariance = np.array(sensor_result["covariance"])
    return CalibrationOutcome(
        failure_reason="",
        error=compute_pose_error(T_true, T),
        sigma=sigma_mm_deg(covariance),
        nees_ratio=compute_nees(T_true, T, covariance),
        reference=reference,
        pixel_error_px=pixel_error_px,
    )


def summarize_logs(
    row: AccuracyRow, n_placements: int, method: str, outcomes: list[CalibrationOutcome]
) -> AccuracyLine:
    """Combine the outcomes of all logs of one row, number of placements and method."""
    good = [o for o in outcomes if not o.failure_reason]
    failure_reasons = tuple(o.failure_reason for o in outcomes if o.failure_reason)
    if not good:
        none = (np.nan, np.nan)
        return AccuracyLine(
            row=row,
            n_placements=n_placements,
            method=method,
            n_logs=0,
            error=none,
            sigma=none,
            reference=none,
            mean_nees=np.nan,
            worst_error_ratio=np.nan,
            pixel_error_px=np.nan,
            failure_reasons=failure_reasons,
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
        failure_reasons=failure_reasons,
    )


def _rms(pairs: list[tuple[float, float]]) -> tuple[float, float]:
    first, second = np.sqrt(np.mean(np.square(pairs), axis=0)).tolist()
    return first, second


def find_accuracy_goal(
    row: AccuracyRow, n_placements: int, statistics: HasReference
) -> tuple[float, float]:
    """Return the goal (mm, deg) of a row: its own, or MAX_RMS_RATIO times the reference."""
    if row.goals:
        return row.goals[n_placements]
    mm, deg = statistics.reference
    return MAX_RMS_RATIO * mm, MAX_RMS_RATIO * deg


def summarize_outcomes(outcomes: dict[AccuracyCase, CalibrationOutcome]) -> list[AccuracyLine]:
    """Return the lines of the table from the outcomes by case, in the order of the rows."""
    grouped: dict[tuple[str, int, str], list[AccuracyCase]] = {}
    for case in sorted(outcomes, key=_case_order):
        grouped.setdefault((case.row.key, case.n_placements, case.method), []).append(case)
    return [
        summarize_logs(
            cases[0].row,
            n_placements=cases[0].n_placements,
            method=cases[0].method,
            outcomes=[outcomes[case] for case in cases],
        )
        for cases in grouped.values()
    ]


def _case_order(case: AccuracyCase) -> tuple[int, int, int, int]:
    keys = [row.key for row in ACCURACY_ROWS]
    return (
        keys.index(case.row.key),
        -case.n_placements,
        case.row.methods.index(case.method),
        case.seed,
    )
