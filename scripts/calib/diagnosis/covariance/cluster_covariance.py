"""Covariance by clusters: what the scores of whole placements scatter by beyond the model.

A placement may have an error of its own that no noise model contains. The sandwich covariance
(White 1982) takes the scatter of the scores from the data, cluster by cluster of placements, each
corrected for its leverage (CR2; Bell and McCaffrey 2002). With few clusters it scatters itself, so
its eigenvalues in the metric of the model's covariance are shrunk to their mean (Ledoit and Wolf
2004), and the larger of both counts in every direction (matrix maximum).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from calib.diagnosis.covariance.consider_covariance import with_consider_covariance
from calib.diagnosis.error_search.score_terms import placement_clusters
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.nlp.information_matrix import (
    MIN_EIGENVALUE_RATIO,
    covariance_from_information,
    invert_information,
    scale_to_unit_diagonal,
)
from calib.estimation.nlp.measurement_factor import Factor
from calib.estimation.pose_chain import prior_means_and_weights

MAX_LEVERAGE = 0.99  # of a cluster on a direction; beyond it the others say nothing of its error
POSE_SIZE = 6


@dataclass(frozen=True)
class ClusterScore:
    """Information (s, s) and score (s,) of a cluster about the unknowns that clusters share."""

    information: np.ndarray
    score: np.ndarray


class _ExcessFactor(NamedTuple):
    """The excess of one pose, root rootᵀ (6, 6), and how the clusters shift it.

    unit_shifts: (k, 6) along the columns of root, orthonormal.
    """

    root: np.ndarray
    unit_shifts: np.ndarray


def with_cluster_covariance(setup: Setup, result: EstimationResult) -> EstimationResult:
    """Return the result with what the clusters scatter by beyond the model, added to its poses."""
    if result.solve_result is None:
        return result
    return result.with_added_covariance(cluster_excess(setup, result))


def with_reported_covariance(setup: Setup, result: EstimationResult) -> EstimationResult:
    """Return the result with the covariance that is reported.

    That of the model, of the errors that are not estimated, and of the clusters.
    """
    return with_cluster_covariance(setup, with_consider_covariance(setup, result))


def excess_map(model_covariance: np.ndarray, added_covariance: np.ndarray) -> np.ndarray:
    """Return the map G (d, d) of errors by which a model's covariance becomes the reported one.

    G P Gᵀ is P with the addition; with more placements P decreases, and the addition in proportion.
    """
    root, inverse = _square_root(model_covariance)
    values, vectors = np.linalg.eigh(inverse @ added_covariance @ inverse.T)
    return root @ (vectors * np.sqrt(1 + np.maximum(values, 0.0))) @ vectors.T @ inverse


def cluster_excess(setup: Setup, result: EstimationResult) -> np.ndarray:
    """Return the covariance (m, m) of sensor poses and mounts beyond that of the model.

    Of each pose it is the excess of the matrix maximum; between poses it is correlated as the
    scores of the clusters are.
    """
    m, shared = setup.n_pose_unknowns, _shared_unknowns(setup)
    scores = cluster_scores(setup, result)
    if len(scores) < 2:
        return np.zeros((m, m))
    weight = prior_means_and_weights(setup, result.state)[1][shared]
    fixed = np.diag(weight**2) + _moving_information(setup, result)
    P = covariance_from_information(sum(c.information for c in scores) + fixed)
    shifts = np.stack([P @ corrected_score(c, P) for c in scores])[:, :m]
    modelled = (P @ fixed @ P)[:m, :m]
    blocks = [slice(i, i + POSE_SIZE) for i in range(0, m, POSE_SIZE)]
    factors = [_excess_factor(P[at, at], shifts[:, at], modelled[at, at]) for at in blocks]
    root = block_diag(*(factor.root for factor in factors))
    unit_shifts = np.hstack([factor.unit_shifts for factor in factors])
    is_same = block_diag(*(np.ones((f.root.shape[1],) * 2, bool) for f in factors))
    correlation = np.where(is_same, np.eye(len(is_same)), unit_shifts.T @ unit_shifts)
    return root @ correlation @ root.T


def corrected_score(cluster: ClusterScore, covariance: np.ndarray) -> np.ndarray:
    """Return the score (s,) of a cluster as it would be, had the estimate not followed it.

    covariance: (s, s) of the estimate. With H = L Lᵀ the score is L u, and u has the covariance
    1 - Lᵀ P L, the leverage of the cluster on its own directions; it is scaled back to 1.
    """
    L, inverse = _square_root(cluster.information)
    leverage, vectors = np.linalg.eigh(L.T @ covariance @ L)
    is_free = leverage < MAX_LEVERAGE
    u = vectors.T @ (inverse @ cluster.score)
    factor = np.where(is_free, 1 / np.sqrt(np.where(is_free, 1 - leverage, 1.0)), 0.0)
    return L @ (vectors @ (factor * u))


def shrink_eigenvalues(values: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Return eigenvalues (d,) of Σ x xᵀ + Q, shrunk to their mean by the share of chance.

    shifts: the x (k, d), in the metric of the model. The share is that of the eigenvalues' spread
    which the k terms of the sum show to be by chance (Ledoit and Wolf 2004).
    """
    mean = values.mean()
    spread = float(np.sum((values - mean) ** 2))
    squares = float(np.sum((shifts.T @ shifts) ** 2))
    by_chance = float(np.sum(np.sum(shifts**2, axis=1) ** 2)) - squares / len(shifts)
    share = min(by_chance / spread, 1.0) if spread > 0 else 1.0
    return mean + (1 - share) * (values - mean)


def cluster_scores(setup: Setup, result: EstimationResult) -> list[ClusterScore]:
    """Return the score of every cluster of still placements, its own unknowns eliminated."""
    error_columns = np.arange(setup.n_pose_unknowns, setup.n_chain_unknowns)
    factors = result.solved.factors
    numbers = placement_clusters(setup, factors, error_columns)
    by_cluster: dict[int, list[Factor]] = {}
    for group, factor in zip(setup.groups, factors, strict=True):
        if not group.is_moving:
            by_cluster.setdefault(int(numbers[group.placement]), []).append(factor)
    return [
        _eliminate_own_unknowns(setup, result, parts) for _, parts in sorted(by_cluster.items())
    ]


def _eliminate_own_unknowns(
    setup: Setup, result: EstimationResult, factors: Sequence[Factor]
) -> ClusterScore:
    """Return the information and the score of the factors about the shared unknowns."""
    shared = _shared_unknowns(setup)
    columns = np.unique(np.concatenate([f.columns for f in factors]))
    is_own = ~np.isin(columns, shared)
    H, g = np.diag(is_own.astype(float)), np.zeros(len(columns))
    g[is_own] = result.state.mocap_errors.reshape(-1)[columns[is_own] - setup.n_pose_unknowns]
    for factor in factors:
        at = np.searchsorted(columns, factor.columns)
        H[np.ix_(at, at)] += factor.hessian_x
        g[at] += factor.gradient_x
    gain = H[np.ix_(~is_own, is_own)] @ invert_information(H[np.ix_(is_own, is_own)])
    at = np.searchsorted(shared, columns[~is_own])
    information, score = np.zeros((len(shared), len(shared))), np.zeros(len(shared))
    information[np.ix_(at, at)] = H[np.ix_(~is_own, ~is_own)] - gain @ H[np.ix_(is_own, ~is_own)]
    score[at] = g[~is_own] - gain @ g[is_own]
    return ClusterScore(information, score)


def _moving_information(setup: Setup, result: EstimationResult) -> np.ndarray:
    """Return the information (s, s) of moving views about the shared unknowns, as modelled."""
    factors = [f for g, f in zip(setup.groups, result.solved.factors, strict=True) if g.is_moving]
    shared = _shared_unknowns(setup)
    if not factors:
        return np.zeros((len(shared), len(shared)))
    return _eliminate_own_unknowns(setup, result, factors).information


def _shared_unknowns(setup: Setup) -> np.ndarray:
    """Return the unknowns (s,) that clusters share: poses, mounts and corrections."""
    columns = np.arange(setup.n_unknowns)
    return columns[(columns < setup.n_pose_unknowns) | (columns >= setup.n_chain_unknowns)]


def _excess_factor(
    covariance: np.ndarray, shifts: np.ndarray, modelled: np.ndarray
) -> _ExcessFactor:
    """Return the excess of one pose.

    covariance: (6, 6) of the model; shifts: (k, 6) by the clusters; modelled: (6, 6) the part of
    the covariance that no cluster brings in.
    """
    root, inverse = _square_root(covariance)
    x = shifts @ inverse.T
    values, vectors = np.linalg.eigh(x.T @ x + inverse @ modelled @ inverse.T)
    excess = np.maximum(shrink_eigenvalues(values, x) - 1, 0.0)
    left, _, right = np.linalg.svd(x @ vectors, full_matrices=False)
    return _ExcessFactor(root @ (vectors * np.sqrt(excess)), left @ right)


def _square_root(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return L (s, r) with L Lᵀ the positive semidefinite matrix of rank r, and L⁻¹ (r, s)."""
    is_known = np.diag(matrix) > 0
    scale, unit = scale_to_unit_diagonal(matrix[np.ix_(is_known, is_known)])
    values, vectors = np.linalg.eigh(unit)
    kept = values > MIN_EIGENVALUE_RATIO * values.max(initial=0.0)
    V, size = vectors[:, kept], np.sqrt(values[kept])
    root, inverse = np.zeros((len(matrix), kept.sum())), np.zeros((kept.sum(), len(matrix)))
    root[is_known], inverse[:, is_known] = V * size / scale[:, None], (V / size).T * scale
    return root, inverse
