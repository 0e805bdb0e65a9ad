"""The terms of the score tests: residuals at the optimum by noise, with their derivatives."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from calib.estimation.corrections.base import TestableCorrection
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.corrections.score_test import NoiseTerm, PriorNoiseTerm, ScoreBlock
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.nlp.information_matrix import invert_information
from calib.estimation.nlp.measurement_factor import Factor
from calib.estimation.noise.noise_model import noise_key
from calib.estimation.pose_chain import model_with_corrections
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS

MIN_VARIANCE_FACTOR = 1e-4  # on the estimated variance
MOCAP_NOISE_NAME = "mocap_noise"
MIN_ERROR_VARIANCE = 1e-9  # of an error of the motion capture, in units of its prior


class Candidate(NamedTuple):
    """A correction that is tested, and its parameters (q,) among those of all candidates."""

    correction: TestableCorrection
    columns: np.ndarray


def list_candidates(corrections: Sequence[TestableCorrection]) -> list[Candidate]:
    """Number the parameters of the corrections one after the other."""
    ends = np.cumsum([0] + [c.n_values for c in corrections])
    return [
        Candidate(c, np.arange(start, end))
        for c, start, end in zip(corrections, ends[:-1], ends[1:], strict=True)
    ]


def make_noise_terms(
    setup: Setup, result: EstimationResult, candidates: list[Candidate]
) -> dict[str, NoiseTerm]:
    """Return the terms at the optimum, by noise: "sensor/kind", or MOCAP_NOISE_NAME."""
    factors = result.solved.factors
    error_columns = np.arange(setup.n_pose_unknowns, setup.n_chain_unknowns)
    clusters = placement_clusters(setup, factors, error_columns)
    blocks: dict[str, list[ScoreBlock]] = {}
    min_factors: dict[str, float] = {}
    for group, assignment, factor in zip(setup.groups, result.assignments, factors, strict=True):
        model = model_with_corrections(setup, result.state, group)
        linearization = GroupLinearization(
            setup, result.state, model, group, assignment, factor.J_pose
        )
        noise = f"{group.sensor}/{group.kind}"
        blocks.setdefault(noise, []).append(
            _measurement_block(linearization, factor, candidates, clusters[group.placement])
        )
        # If σ is the step of a scan pattern, it is at least that step.
        is_step = RESIDUAL_KINDS[group.kind].MIN_SIGMA is None
        scale = result.state.noise[noise_key(group)].total
        min_factors[noise] = 1 / scale**2 if is_step else MIN_VARIANCE_FACTOR
    n_unknowns = len(result.solved.information)
    n_parameters = sum(len(c.columns) for c in candidates)
    cluster_of_column = _clusters_of_columns(setup, factors, clusters)
    mocap_term = PriorNoiseTerm(
        _mocap_blocks(result, error_columns, cluster_of_column),
        n_unknowns,
        n_parameters,
        information=_mocap_information(result, error_columns, cluster_of_column),
        stated_factor=1 / result.state.mocap_noise_factor**2,
    )
    return {
        noise: NoiseTerm(parts, n_unknowns, n_parameters, min_factors[noise])
        for noise, parts in blocks.items()
    } | {MOCAP_NOISE_NAME: mocap_term}


def _clusters_of_columns(
    setup: Setup, factors: Sequence[Factor], clusters: np.ndarray
) -> dict[int, int]:
    """Return the cluster of placements by the index of an unknown that moves one of them."""
    out: dict[int, int] = {}
    for group, factor in zip(setup.groups, factors, strict=True):
        out |= dict.fromkeys(factor.columns.tolist(), int(clusters[group.placement]))
    return out


def _measurement_block(
    linearization: GroupLinearization, factor: Factor, candidates: list[Candidate], cluster: int
) -> ScoreBlock:
    """Return the block of one group of measurements."""
    setup, group = linearization.setup, linearization.group
    affecting = [c for c in candidates if c.correction.affects(setup, group)]
    n_components, n = factor.residuals.shape
    D = np.concatenate(
        [
            np.zeros((0, n_components, n)),
            *(c.correction.derivative(linearization) for c in affecting),
        ]
    )
    w, r = factor.weight, factor.residuals
    return ScoreBlock(
        cluster=cluster,
        columns=factor.columns,
        correction_index=np.concatenate([np.zeros(0, int), *(c.columns for c in affecting)]),
        H=factor.hessian_x,
        G=factor.cross_information(D),
        K=np.einsum("pkn,qkn->pq", D * w, D, optimize=True),
        gradient=factor.gradient_x,
        score=np.einsum("qkn,kn->q", D * w, r, optimize=True),
        squared_residuals=float(np.sum(w * r**2)),
        n_terms=float(np.sum(w)) * len(r),
    )


def _mocap_blocks(
    result: EstimationResult, error_columns: np.ndarray, cluster_of_column: Mapping[int, int]
) -> list[ScoreBlock]:
    """Return one block for each MCS error; it counts as far as the data determine it."""
    n_determined = count_determined_unknowns(result.solved.information, error_columns)
    n_terms = n_determined / len(error_columns)
    values = result.state.mocap_errors.reshape(-1)
    return [
        ScoreBlock(
            cluster=cluster_of_column.get(column, -1),
            columns=np.array([column]),
            correction_index=np.zeros(0, int),
            H=np.eye(1),
            G=np.zeros((1, 0)),
            K=np.zeros((0, 0)),
            gradient=np.array([value]),
            score=np.zeros(0),
            squared_residuals=float(value**2),
            n_terms=n_terms,
        )
        for column, value in zip(error_columns.tolist(), values, strict=True)
    ]


def _mocap_information(
    result: EstimationResult, error_columns: np.ndarray, cluster_of_column: Mapping[int, int]
) -> np.ndarray:
    """Return what the measurements tell about the MCS errors (k,), in units of their priors.

    Along the axes of their covariance, cluster by cluster: placements of different clusters share
    no error.
    """
    covariance = invert_information(result.solved.information)
    numbers = np.array([cluster_of_column.get(c, -1) for c in error_columns.tolist()])
    parts = [np.zeros(0)]
    for number in np.unique(numbers):
        columns = error_columns[numbers == number]
        variances = np.linalg.eigvalsh(covariance[np.ix_(columns, columns)])
        parts.append(np.maximum(1 / np.maximum(variances, MIN_ERROR_VARIANCE) - 1, 0.0))
    return np.concatenate(parts)


def count_determined_unknowns(information: np.ndarray, columns: np.ndarray) -> float:
    """Return how many of the unknowns with unit priors the data determine (MacKay 1992)."""
    return float(np.sum(1 - np.diag(invert_information(information))[columns]))


def placement_clusters(
    setup: Setup, factors: Sequence[Factor], tie_columns: np.ndarray
) -> np.ndarray:
    """Return the number of the cluster of each placement: those that share unknowns.

    factors: of the groups, in order. tie_columns: the unknowns that tie placements together.
    """
    columns_by_group = [np.intersect1d(f.columns, tie_columns) for f in factors]
    rows = np.repeat([g.placement for g in setup.groups], [len(c) for c in columns_by_group])
    columns = np.concatenate([*columns_by_group, np.zeros(0, int)]).astype(int)
    n, m = len(setup.placements), int(max(columns, default=-1)) + 1
    ties = sparse.coo_matrix((np.ones(len(rows)), (rows, n + columns)), (n + m, n + m))
    return connected_components(ties, directed=False)[1][:n]
