"""Leave-one-out: the influence of each placement, and how well the others predict it.

Computed from the normal equations at the optimum, without solving again: the terms of a placement
are removed, followed by one Gauss-Newton step. This is first order: exact if residuals are linear
over this small step, with inliers, weights and noise unchanged.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.covariance.consider_covariance import unestimated_variance
from calib.diagnosis.observability import UNDETERMINED_SIGMA
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult, SolveResult
from calib.estimation.nlp.information_matrix import invert_information, scale_to_unit_diagonal
from calib.estimation.nlp.measurement_factor import Factor

MAX_TARGET_POSE_SIGMA = 0.05  # m, rad: one placement does not determine a direction beyond this
MIN_CURVE_PLACEMENTS = 3  # minimum number of placements for which σ is predicted
N_CURVE_POINTS = 12
N_RANDOM_ORDERS = 8  # orders of the placements over which the median is taken


@dataclass(frozen=True)
class HeldOutError:
    """T_sensor_target of a placement that was left out, against its prediction by the others.

    error: (6,) m and rad, in the directions that the placement determines. nees: normalised squared
    error, on average n_directions.
    """

    error: np.ndarray
    nees: float
    n_directions: int


@dataclass(frozen=True)
class LeaveOneOut:
    """One placement left out.

    influence_by_sensor: by how many σ, √(ξᵀΣ⁻¹ξ), the pose changes; infinite if the others do not
    determine it. error_by_sensor: of the sensors that saw the placement.
    """

    placement: int
    influence_by_sensor: dict[str, float]
    error_by_sensor: dict[str, HeldOutError]


@dataclass(frozen=True)
class _SensorFactor:
    """A factor and the sensor whose measurements it holds."""

    sensor: str
    factor: Factor


def leave_one_out(setup: Setup, result: EstimationResult) -> list[LeaveOneOut]:
    """Leave out each placement that has measurements, in order."""
    names, solved = sorted(setup.models), result.solved
    by_placement: dict[int, list[_SensorFactor]] = {}
    for group, factor in zip(setup.groups, result.solved.factors, strict=True):
        if not group.is_moving:
            item = _SensorFactor(group.sensor, factor)
            by_placement.setdefault(group.placement, []).append(item)
    return [_leave_placement_out(k, by_placement[k], names, solved) for k in sorted(by_placement)]


def leave_one_out_rms(setup: Setup, result: EstimationResult) -> float:
    """Return the rms leave-one-out error of the target positions, m."""
    errors = [
        held_out.error[:3]
        for placement in leave_one_out(setup, result)
        for held_out in placement.error_by_sensor.values()
    ]
    return float(np.sqrt(np.mean(np.square(errors)) * 3)) if errors else np.inf


def _leave_placement_out(
    placement: int, items: list[_SensorFactor], names: list[str], solved: SolveResult
) -> LeaveOneOut:
    """Leave out one placement. names: sensors in the order of the unknowns."""
    covariance, reported = solved.model_covariance, solved.covariance
    sensors = sorted({item.sensor for item in items})
    columns = np.unique(np.concatenate([item.factor.columns for item in items]))
    H, g = np.zeros((len(columns), len(columns))), np.zeros(len(columns))
    for item in items:
        at = np.searchsorted(columns, item.factor.columns)
        H[np.ix_(at, at)] += item.factor.hessian_x
        g[at] += item.factor.gradient_x
    # Woodbury: with E the columns concerned, (P⁻¹ - E H Eᵀ)⁻¹ E = P E (1 - H Eᵀ P E)⁻¹.
    mixed = np.eye(len(columns)) - H @ covariance[np.ix_(columns, columns)]
    rest = np.linalg.lstsq(mixed.T, covariance[columns], rcond=None)[0].T
    rest_covariance = (rest[columns] + rest[columns].T) / 2
    variances = np.diag(rest_covariance)[columns < 6 * len(names)]
    if not (np.isfinite(variances).all() and (np.abs(variances) < UNDETERMINED_SIGMA**2).all()):
        return LeaveOneOut(placement, dict.fromkeys(sensors, np.inf), {})
    step = rest @ g
    errors = {}
    for sensor in sensors:
        factors = [item.factor for item in items if item.sensor == sensor]
        error = _held_out_error(factors, columns, step[columns], rest_covariance)
        if error:
            errors[sensor] = error
    blocks = {name: slice(6 * i, 6 * i + 6) for i, name in enumerate(names)}
    influence = {
        name: _mahalanobis_distance(step[at], reported[at, at]) for name, at in blocks.items()
    }
    return LeaveOneOut(placement, influence, errors)


def _mahalanobis_distance(xi: np.ndarray, covariance: np.ndarray) -> float:
    """Return √(ξᵀΣ⁻¹ξ) of a twist (6,); 0 if the covariance is zero."""
    if not covariance.any():
        return 0.0
    scale, unit = scale_to_unit_diagonal(covariance)
    return float(np.sqrt(max((xi * scale) @ np.linalg.solve(unit, xi * scale), 0.0)))


def _held_out_error(
    factors: Sequence[Factor], columns: np.ndarray, step: np.ndarray, rest_covariance: np.ndarray
) -> HeldOutError | None:
    """Return the leave-one-out error of one sensor, None if the placement determines nothing.

    factors: of the sensor in the placement. columns (m,): unknowns of the placement. step (m,) and
    rest_covariance (m, m): of these unknowns, from the other placements.
    """
    A = np.zeros((6, len(columns)))
    A[:, np.searchsorted(columns, factors[0].columns)] = factors[0].dpose_dx
    M = sum(f.pose_information for f in factors)
    values, vectors = np.linalg.eigh(M)
    is_known = values > MAX_TARGET_POSE_SIGMA**-2
    if not is_known.any():
        return None
    U, values = vectors[:, is_known], values[is_known]
    slope = M @ A
    for f in factors:
        theta_columns = f.columns[len(f.columns) - len(f.J_theta) :]
        slope[:, np.searchsorted(columns, theta_columns)] += f.pose_theta_information
    error = -(U.T @ (sum(f.pose_gradient for f in factors) + slope @ step)) / values
    predicted = U.T @ slope / values[:, None]
    scale, unit = scale_to_unit_diagonal(
        predicted @ rest_covariance @ predicted.T + np.diag(1 / values)
    )
    # Rounding can make it slightly negative, if ranges are exact and poses coarse.
    nees = max(float((error * scale) @ np.linalg.solve(unit, error * scale)), 0.0)
    return HeldOutError(U @ error, nees, int(is_known.sum()))


def sigma_by_placements_json(
    setup: Setup, result: EstimationResult, sensor: str, seed: int = 0
) -> dict[str, list]:
    """Return {"placements", "sigma_m", "sigma_rad"}: σ of a sensor pose by number of placements.

    Each σ is the largest of three components, and the median over random orders of the placements;
    None if a direction is undetermined. The noise is that of all placements. What errors that are
    not estimated add does not decrease with the number of placements.
    """
    index = sorted(setup.models).index(sensor)
    placements = sorted(
        {g.placement for g in setup.groups if g.sensor == sensor and not g.is_moving}
    )
    blocks, rows = _information_by_placement(setup, result, placements)
    at = np.searchsorted(rows, np.arange(6 * index, 6 * index + 6))
    prior = np.diag((rows >= setup.n_pose_unknowns).astype(float))
    last = len(placements)
    counts = np.unique(
        np.geomspace(min(MIN_CURVE_PLACEMENTS, last), last, N_CURVE_POINTS).round().astype(int)
    )
    pose = slice(6 * index, 6 * index + 6)
    added = unestimated_variance(setup, result)[pose]
    growth = result.solved.variance_growth[pose]
    rng = np.random.default_rng(seed)
    sigmas = np.zeros((N_RANDOM_ORDERS, len(counts), 2))
    for draw in sigmas:
        sums = prior + np.cumsum(blocks[rng.permutation(last)], 0)
        for i, n in enumerate(counts):
            sigma = np.sqrt(growth * (np.abs(np.diag(invert_information(sums[n - 1]))[at]) + added))
            draw[i] = sigma[:3].max(), sigma[3:].max()
    sigma_m, sigma_rad = (
        [float(v) if v < UNDETERMINED_SIGMA else None for v in column]
        for column in np.median(sigmas, 0).T
    )
    return {"placements": counts.tolist(), "sigma_m": sigma_m, "sigma_rad": sigma_rad}


def _information_by_placement(
    setup: Setup, result: EstimationResult, placements: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the information (k, m, m) of each placement, and the unknowns (m,) that it is about.

    These are sensor poses and mounts, and what placements share. The other unknowns of a placement
    are marginalised.
    """
    factors: dict[int, list[Factor]] = {}
    for group, factor in zip(setup.groups, result.solved.factors, strict=True):
        if group.placement in placements:
            factors.setdefault(group.placement, []).append(factor)
    columns = {
        k: np.unique(np.concatenate([f.columns for f in parts])) for k, parts in factors.items()
    }
    every, counts = np.unique(np.concatenate(list(columns.values())), return_counts=True)
    rows = every[(counts > 1) | (every < setup.n_pose_unknowns)]
    out = np.zeros((len(placements), len(rows), len(rows)))
    for block, k in zip(out, placements, strict=True):
        is_shared = np.isin(columns[k], rows)
        H = np.diag((~is_shared).astype(float))
        for factor in factors[k]:
            at = np.searchsorted(columns[k], factor.columns)
            H[np.ix_(at, at)] += factor.hessian_x
        cross = H[np.ix_(~is_shared, is_shared)]
        at = np.searchsorted(rows, columns[k][is_shared])
        marginal = cross.T @ invert_information(H[np.ix_(~is_shared, ~is_shared)]) @ cross
        block[np.ix_(at, at)] = H[np.ix_(is_shared, is_shared)] - marginal
    return out, rows
