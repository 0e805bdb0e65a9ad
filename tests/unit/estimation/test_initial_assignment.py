"""Solve starts from the assignments of stage associate."""

import numpy as np
import pytest

import associate
from calib.estimation.estimate_state import initial_state
from calib.estimation.measurement_assignment import assign_at_initial_guess
from calib.estimation.problem_assembly import SessionKeypoints, assemble_setup
from calib.estimation.solver import estimate_poses, start_from_initial_guess
from calib.geometry.se3 import se3_exp
from calib.io.parquet_tables import read_table, write_table
from calib.io.table_schemas import PAIRS_SCHEMA
from helpers import synthetic_setup
from helpers.synthetic_setup import ASSOCIATE_SETTINGS, TARGETS_BY_NAME, TRUE_POSES

LAYOUT = [("board", None), ("cylinder", None), ("board", None), ("board", None)]
START = {n: T @ se3_exp(np.full(6, 0.003)) for n, T in TRUE_POSES.items()}
ONE_ROUND = dict(max_rounds=1, tolerance_m=1e-6, tolerance_rad=1e-6, initial_noise_factor=10.0)


@pytest.fixture(scope="module")
def synthetic():
    return synthetic_setup.make_synthetic_setup(0, LAYOUT)


@pytest.fixture
def pairs(synthetic, tmp_path):
    """Columns of pairs.parquet of the synthetic keypoints, written and read again."""
    write_table(tmp_path / "pairs", PAIRS_SCHEMA, associate.assign_keypoints(synthetic, START))
    columns, _, _ = read_table(tmp_path / "pairs", PAIRS_SCHEMA)
    return {k: np.array(v) for k, v in columns.items()}


def setup_of(synthetic, columns):
    """The Setup that solve builds of such columns."""
    session = SessionKeypoints(
        session="s",
        keypoints=columns,
        placements=dict(enumerate(synthetic.placements)),
        T_robot_sensor=START,
    )
    return assemble_setup(
        [session],
        models=synthetic.models,
        targets=TARGETS_BY_NAME,
        associate_options=ASSOCIATE_SETTINGS,
    )


def without_assignments(columns):
    return {k: v for k, v in columns.items() if k != "candidate_feature"}


def start_of(setup):
    return start_from_initial_guess(setup, initial_state(setup, START, 10.0))


def test_assignments_of_associate_are_those_that_solve_would_choose(synthetic, pairs):
    kept, chosen = setup_of(synthetic, pairs), setup_of(synthetic, without_assignments(pairs))
    assert all(g.initial_features is None for g in chosen.groups)
    (state, assignments), (expected_state, expected) = start_of(kept), start_of(chosen)
    assert state.noise == expected_state.noise
    for a, b in zip(assignments, expected, strict=True):
        np.testing.assert_array_equal(a.feature, b.feature)
        np.testing.assert_array_equal(a.residual, b.residual)
        np.testing.assert_array_equal(a.data, b.data)
        np.testing.assert_array_equal(a.weight, b.weight)


def test_pairs_hold_the_residuals_at_the_start_of_solve(synthetic, pairs):
    setup = setup_of(synthetic, pairs)
    _, assignments = start_of(setup)
    size = np.concatenate([a.standardized_norm for a in assignments])
    order = np.concatenate([_rows_of(pairs, g) for g in setup.groups])
    np.testing.assert_array_equal(pairs["standardized_residual"][order], size)
    is_inlier = np.concatenate([a.feature >= 0 for a in assignments])
    np.testing.assert_array_equal(pairs["is_inlier"][order], is_inlier)
    assert is_inlier.mean() > 0.5
    corners = pairs["kind"] == "pattern_corner"
    distance = np.linalg.norm(pairs["residual"][corners], axis=1)
    assert 1 < np.median(distance) < 20  # px, of a start that is 3 mm and 0.17° off
    assert np.all(pairs["residual"][~corners, 1] == 0)


def _rows_of(pairs, group):
    number = int(group.keypoints["placement"][0])
    return np.flatnonzero(
        (pairs["sensor"] == group.sensor)
        & (pairs["kind"] == group.kind)
        & (pairs["placement"] == number)
    )


@pytest.mark.parametrize("kind", ["pattern_corner", "target_surface", "board_outline"])
def test_a_measurement_that_pairs_assign_to_nothing_is_no_inlier_at_the_start(
    synthetic, pairs, kind
):
    (row, *_) = np.flatnonzero((pairs["kind"] == kind) & pairs["is_inlier"])
    pairs["candidate_feature"][row] = -1
    setup = setup_of(synthetic, pairs)
    _, assignments = start_of(setup)
    for g, a in zip(setup.groups, assignments, strict=True):
        rows = _rows_of(pairs, g)
        assert (a.feature[rows == row] == -1).all()
        np.testing.assert_array_equal(
            a.feature[rows != row] >= 0, pairs["is_inlier"][rows[rows != row]]
        )


def test_altered_assignments_change_where_solve_starts(synthetic, pairs):
    """Corners of one board, each assigned to its neighbour: residuals of a square, another pose."""
    before = setup_of(synthetic, pairs)
    rows = (pairs["kind"] == "pattern_corner") & (pairs["placement"] == 0)
    pairs["candidate_feature"][rows] = np.roll(pairs["candidate_feature"][rows], 1)
    after = setup_of(synthetic, pairs)
    state = initial_state(after, START, 10.0)
    changed = [
        not np.array_equal(a.residual, b.residual)
        for a, b in zip(
            assign_at_initial_guess(before, state),
            assign_at_initial_guess(after, state),
            strict=True,
        )
    ]
    assert [g.kind for g, c in zip(after.groups, changed, strict=True) if c] == ["pattern_corner"]
    poses = [
        estimate_poses(made, START, **ONE_ROUND).state.T_robot_sensor["camera"]
        for made in (before, after)
    ]
    assert np.abs(poses[0] - poses[1]).max() > 1e-5
