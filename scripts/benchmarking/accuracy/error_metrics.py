"""Errors against the truth, of one calibration and over several logs."""

from dataclasses import dataclass

import numpy as np

from benchmarking.accuracy.accuracy_cases import ENSEMBLE, ROWS
from calib.geometry import se3


@dataclass(frozen=True)
class Outcome:
    """One finished calibration: (mm, deg) of its error, of σ as reported and of the reference;
    NEES/6 is 1 on average where the covariance is honest. reason: why there is no pose, or ""."""

    reason: str
    error: tuple = (np.nan, np.nan)
    sigma: tuple = (np.nan, np.nan)
    nees: float = np.nan
    reference: tuple = (np.nan, np.nan)
    pixels: float = np.nan  # error of a corner or contour point per axis at the truth, px, rms


@dataclass(frozen=True)
class Line:
    """One line of the table: a row, N and method over its logs.

    error, sigma, reference: (mm, deg), root mean square over the logs; worst: the largest error
    over its own log's reference, of mm and deg; pixels: as of an Outcome, mean; lost: reasons of
    the logs without a pose.
    """

    row: object
    n: int
    method: str
    logs: int
    error: tuple
    sigma: tuple
    reference: tuple
    nees: float
    worst: float
    pixels: float
    lost: tuple


def error(T_true, T_found):
    """(mm, deg): the norm of the difference in translation, the geodesic angle in rotation."""
    shift = np.linalg.norm(T_found[:3, 3] - T_true[:3, 3])
    return 1e3 * float(shift), float(np.degrees(se3.angle(se3.inverse(T_true) @ T_found)))


def spread(covariance):
    """(mm, deg) of a covariance (6, 6): square roots of the traces of its two blocks."""
    shift, turn = (np.sqrt(np.trace(covariance[b, b])) for b in (np.s_[:3], np.s_[3:]))
    return 1e3 * float(shift), float(np.degrees(turn))


def nees(T_true, T_found, covariance):
    """Normalised estimation error squared over its six degrees of freedom."""
    xi = se3.se3_log(se3.inverse(T_found) @ T_true)
    return float(xi @ np.linalg.solve(covariance, xi)) / 6


def outcome(sensor, T_true, reference, pixels):
    """The Outcome of one sensor of calibration.json; reference: (mm, deg) of the data."""
    if sensor["T_robot_sensor"] is None:
        return Outcome(sensor["status"]["reason"])
    T = np.array(sensor["T_robot_sensor"]["matrix"])
    covariance = np.array(sensor["covariance"])
    found = error(T_true, T), spread(covariance), nees(T_true, T, covariance)
    return Outcome("", *found, reference, pixels)


def line(row, n, method, outcomes):
    """The Line over the Outcomes of one row, N and method."""
    good = [o for o in outcomes if not o.reason]
    lost = tuple(o.reason for o in outcomes if o.reason)
    if not good:
        none = (np.nan, np.nan)
        return Line(row, n, method, 0, none, none, none, np.nan, np.nan, np.nan, lost)
    rms = {k: _rms([getattr(o, k) for o in good]) for k in ("error", "sigma", "reference")}
    with np.errstate(divide="ignore", invalid="ignore"):
        worst = max(float(np.max(np.divide(o.error, o.reference))) for o in good)
    mean, pixels = (float(np.mean([getattr(o, k) for o in good])) for k in ("nees", "pixels"))
    more = {"nees": mean, "worst": worst, "pixels": pixels, "lost": lost}
    return Line(row, n, method, len(good), **rms, **more)


def _rms(pairs):
    return tuple(np.sqrt(np.mean(np.square(pairs), axis=0)).tolist())


def goal(row, n, found):
    """(mm, deg) that a row is held to at N: its own, or a multiple of the reference found."""
    return row.goal[n] if row.goal else tuple(ENSEMBLE * r for r in found.reference)


def lines(outcomes):
    """The Lines of {case: Outcome}, in the order of the cases."""
    grouped = {}
    for case in sorted(outcomes, key=_order):
        grouped.setdefault((case.row.key, case.n, case.method), []).append(case)
    return [
        line(found[0].row, found[0].n, found[0].method, [outcomes[case] for case in found])
        for found in grouped.values()
    ]


def _order(case):
    keys = [row.key for row in ROWS]
    return keys.index(case.row.key), -case.n, case.row.methods.index(case.method), case.seed
