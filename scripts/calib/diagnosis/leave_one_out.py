"""What every placement does to the result, and how well the others predict it.

From the normal equations at the optimum, without solving again: a placement is left out by taking
its terms off and one Gauss-Newton step of the rest. That is first order: exact as far as residuals
are linear over so small a step, with members, weights and noise held.
"""

from dataclasses import dataclass

import numpy as np

from calib.diagnosis.consider_covariance import unestimated_variance
from calib.diagnosis.observability import UNDETERMINED_SIGMA
from calib.estimation.nlp.information_matrix import invert_information, scale_to_unit_diagonal

MAX_TARGET_POSE_SIGMA = (
    0.05  # m, rad: a direction of T_sensor_target that one placement tells no better is unknown
)
MIN_CURVE_PLACEMENTS = 3  # fewest placements of which a σ is predicted
N_CURVE_POINTS = 12  # numbers of placements for which it is
N_RANDOM_ORDERS = 8  # orders of the placements, of which the median is taken


@dataclass(frozen=True)
class HeldOutError:
    """What a placement left out says of T_sensor_target, against what the rest predicts.

    error (6,): m and rad, in the directions that the placement tells; nees: of it, by the σ of
    both, which is as large as there are directions on average.
    """

    error: np.ndarray
    nees: float
    n_directions: int


@dataclass(frozen=True)
class LeaveOneOut:
    """One placement left out.

    influence {sensor: by how many σ, √(ξᵀΣ⁻¹ξ), its pose moves}, infinite where the rest no longer
    determines it; held {sensor: Held} of the sensors that saw it.
    """

    placement: int
    influence_by_sensor: dict
    error_by_sensor: dict


def leave_one_out(setup, result):
    """A Left for every placement that has measurements, in order."""
    names, P = sorted(setup.models), result.solve_result.covariance
    own = {}
    for g, part in zip(setup.groups, result.solve_result.factors, strict=True):
        if not g.is_moving:
            own.setdefault(g.placement, []).append((g.sensor, part))
    return [_leave_placement_out(k, own[k], names, P) for k in sorted(own)]


def leave_one_out_rms(setup, result):
    """RMS, m, of what placements left out say of their targets' positions against the others."""
    held = [
        h.error[:3] for left in leave_one_out(setup, result) for h in left.error_by_sensor.values()
    ]
    return float(np.sqrt(np.mean(np.square(held)) * 3)) if held else np.inf


def _leave_placement_out(k, sensor_factors, names, covariance):
    """The Left of placement k, of which [(sensor, parts.Part)] are `own`."""
    columns = np.unique(np.concatenate([p.columns for _, p in sensor_factors]))
    H, g = np.zeros((len(columns), len(columns))), np.zeros(len(columns))
    for _, part in sensor_factors:
        at = np.searchsorted(columns, part.columns)
        H[np.ix_(at, at)] += part.hessian_x
        g[at] += part.gradient_x
    # Woodbury: with E the columns concerned, (P⁻¹ - E H Eᵀ)⁻¹ E = P E (1 - H Eᵀ P E)⁻¹.
    mixed = np.eye(len(columns)) - H @ covariance[np.ix_(columns, columns)]
    rest = np.linalg.lstsq(mixed.T, covariance[columns], rcond=None)[0].T
    spread = (rest[columns] + rest[columns].T) / 2
    variances = np.diag(spread)[columns < 6 * len(names)]
    if not (np.isfinite(variances).all() and (np.abs(variances) < UNDETERMINED_SIGMA**2).all()):
        return LeaveOneOut(k, dict.fromkeys(sorted({s for s, _ in sensor_factors}), np.inf), {})
    step = rest @ g
    seen = sorted({s for s, _ in sensor_factors})
    held = {
        s: _held_out_error([p for t, p in sensor_factors if t == s], columns, step[columns], spread)
        for s in seen
    }
    blocks = {n: slice(6 * i, 6 * i + 6) for i, n in enumerate(names)}
    influence = {n: _mahalanobis_distance(step[at], covariance[at, at]) for n, at in blocks.items()}
    return LeaveOneOut(k, influence, {s: h for s, h in held.items() if h})


def _mahalanobis_distance(xi, block):
    """√(ξᵀΣ⁻¹ξ) of a twist (6,); 0 of a pose that nothing tells."""
    if not block.any():
        return 0.0
    scale, unit = scale_to_unit_diagonal(block)
    return float(np.sqrt(max((xi * scale) @ np.linalg.solve(unit, xi * scale), 0.0)))


def _held_out_error(factors, columns, step, rest_covariance):
    """The Held of one sensor's Parts, the others having moved the unknowns by step; or None."""
    A = np.zeros((6, len(columns)))
    A[:, np.searchsorted(columns, factors[0].columns)] = factors[0].dpose_dx
    M = sum(p.pose_information for p in factors)
    values, vectors = np.linalg.eigh(M)
    known = values > MAX_TARGET_POSE_SIGMA**-2
    if not known.any():
        return None
    U, values = vectors[:, known], values[known]
    slope = M @ A
    for p in factors:
        slope[:, np.searchsorted(columns, p.columns[len(p.columns) - len(p.J_theta) :])] += (
            p.pose_theta_information
        )
    own = -(U.T @ (sum(p.pose_gradient for p in factors) + slope @ step)) / values
    predicted = U.T @ slope / values[:, None]
    scale, unit = scale_to_unit_diagonal(
        predicted @ rest_covariance @ predicted.T + np.diag(1 / values)
    )
    # Negative by rounding alone: exact ranges beside coarse poses leave nothing else of it.
    nees = max(float((own * scale) @ np.linalg.solve(unit, own * scale)), 0.0)
    return HeldOutError(U @ own, nees, int(known.sum()))


def sigma_by_placements_json(setup, result, sensor, seed=0):
    """{"placements": [n], "sigma_m": [], "sigma_rad": []}: what the σ of a sensor's pose would be
    of the first n of its placements, the median over random orders of them.

    Each is the largest of three; None where so few leave a direction open. Noise as estimated from
    all placements; what errors that nobody estimates add, no number of placements takes away.
    """
    index = sorted(setup.models).index(sensor)
    own = sorted({g.placement for g in setup.groups if g.sensor == sensor and not g.is_moving})
    blocks, rows = _information_by_placement(setup, result, own)
    at = np.searchsorted(rows, np.arange(6 * index, 6 * index + 6))
    prior = np.diag((rows >= setup.n_pose_unknowns).astype(float))
    last = len(own)
    counts = np.unique(
        np.geomspace(min(MIN_CURVE_PLACEMENTS, last), last, N_CURVE_POINTS).round().astype(int)
    )
    added = unestimated_variance(setup, result)[6 * index : 6 * index + 6]
    rng = np.random.default_rng(seed)
    found = np.zeros((N_RANDOM_ORDERS, len(counts), 2))
    for draw in found:
        sums = prior + np.cumsum(blocks[rng.permutation(last)], 0)
        for i, n in enumerate(counts):
            sigma = np.sqrt(np.abs(np.diag(invert_information(sums[n - 1]))[at]) + added)
            draw[i] = sigma[:3].max(), sigma[3:].max()
    middle = np.median(found, 0)
    told = [[float(v) if v < UNDETERMINED_SIGMA else None for v in column] for column in middle.T]
    return {"placements": counts.tolist(), "sigma_m": told[0], "sigma_rad": told[1]}


def _information_by_placement(setup, result, placement_indices):
    """Information (k, m, m) of each placement of `own` about the unknowns (m,) that it shares with
    others or that are poses; what is its alone is marginalised."""
    used = {}
    for g, part in zip(setup.groups, result.solve_result.factors, strict=True):
        if g.placement in placement_indices:
            used.setdefault(g.placement, []).append(part)
    columns = {k: np.unique(np.concatenate([p.columns for p in v])) for k, v in used.items()}
    every, counts = np.unique(np.concatenate(list(columns.values())), return_counts=True)
    rows = every[(counts > 1) | (every < setup.n_pose_unknowns)]
    out = np.zeros((len(placement_indices), len(rows), len(rows)))
    for block, k in zip(out, placement_indices, strict=True):
        mine = columns[k]
        H = np.diag((~np.isin(mine, rows)).astype(float))
        for part in used[k]:
            at = np.searchsorted(mine, part.columns)
            H[np.ix_(at, at)] += part.hessian_x
        common = np.isin(mine, rows)
        alone = H[np.ix_(~common, ~common)]
        cross = H[np.ix_(~common, common)]
        at = np.searchsorted(rows, mine[common])
        block[np.ix_(at, at)] = (
            H[np.ix_(common, common)] - cross.T @ invert_information(alone) @ cross
        )
    return out, rows
