"""Covariance by clusters: as the model's where it is true, larger where placements err by more."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.covariance.cluster_covariance import (
    cluster_scores,
    shrink_eigenvalues,
    with_cluster_covariance,
)
from calib.geometry.se3 import invert_pose, se3_log, so3_exp
from helpers import synthetic_setup
from helpers.synthetic_setup import make_synthetic_setup, solve_synthetic_setup

BOARDS = [("board", None)] * 16
RANGE_ERROR_M = 0.004  # σ of the error of all ranges in a placement
YAW_ERROR_RAD = np.radians(0.03)  # σ of the error of all outlines in a placement
MOUNT_SIGMA = {"board": np.repeat([0.01, np.radians(1.0)], 3)}


def with_errors_of_placements(made, seed):
    """The Setup in which the lidar's ranges and outlines are off by an error per placement."""
    rng = np.random.default_rng([3, seed])
    longer = RANGE_ERROR_M * rng.normal(size=len(made.placements))
    turns = so3_exp(YAW_ERROR_RAD * rng.normal(size=(len(made.placements), 1)) * [0.0, 0.0, 1.0])

    def moved(g):
        xyz = g.keypoints["xyz"]
        distance = np.linalg.norm(xyz, axis=1)[:, None]
        if g.kind == "board_outline":
            return xyz @ turns[g.placement].T
        return xyz * (1 + longer[g.placement] / distance)

    groups = [
        replace(g, keypoints=g.keypoints | {"xyz": moved(g)}) if g.sensor == "lidar" else g
        for g in made.groups
    ]
    return replace(made, groups=groups)


def nees(result, sensor, covariance):
    """NEES of a sensor's pose over 6, camera first."""
    at = slice(0, 6) if sensor == "camera" else slice(6, 12)
    T = result.state.T_robot_sensor[sensor]
    error = se3_log(invert_pose(synthetic_setup.TRUE_POSES[sensor]) @ T)
    return error @ np.linalg.solve(covariance[at, at], error) / 6


def test_scores_of_clusters_add_up_to_zero_at_the_optimum():
    made = make_synthetic_setup(0, BOARDS)
    scores = cluster_scores(made, solve_synthetic_setup(made))
    assert len(scores) == 16
    largest = np.max([np.abs(c.score) for c in scores], axis=0)
    assert (np.abs(sum(c.score for c in scores)) < 0.02 * largest).all()


def test_placements_that_share_a_rest_of_the_robot_are_one_cluster():
    made = make_synthetic_setup(0, BOARDS)
    places = [replace(p, robot_rest=k // 2) for k, p in enumerate(made.placements)]
    made = replace(made, placements=places)
    assert len(cluster_scores(made, solve_synthetic_setup(made))) == 8


def test_eigenvalues_that_scatter_by_chance_are_shrunk_to_their_mean():
    """Of 20 clusters in 6 directions without any difference: from ±50 % to less than ±15 %."""
    rng = np.random.default_rng(0)
    before, after = [], []
    for _ in range(50):
        x = rng.normal(size=(20, 6)) / np.sqrt(20)
        values = np.linalg.eigvalsh(x.T @ x)
        before.append(np.std(values))
        after.append(np.std(shrink_eigenvalues(values, x)))
    assert np.mean(before) > 0.45 and np.mean(after) < 0.15


def test_a_direction_with_a_large_error_keeps_its_eigenvalue():
    """100 times the variance in one of 6 directions, 40 clusters: within 30 % of 100."""
    rng = np.random.default_rng(0)
    largest = []
    for _ in range(50):
        x = rng.normal(size=(40, 6)) * [10, 1, 1, 1, 1, 1] / np.sqrt(40)
        largest.append(shrink_eigenvalues(np.linalg.eigvalsh(x.T @ x), x)[-1])
    assert np.mean(largest) == pytest.approx(100.0, rel=0.3)


def test_the_joint_covariance_stays_positive_and_no_pose_becomes_more_certain():
    made = replace(
        with_errors_of_placements(make_synthetic_setup(0, BOARDS), 0),
        mount_sigma=MOUNT_SIGMA,
        initial_mounts={"board": np.eye(4)},
    )
    result = with_cluster_covariance(made, solve_synthetic_setup(made))
    added = result.solved.covariance - result.solved.model_covariance
    assert added[:18, :18].any() and not added[18:].any()
    scale = np.sqrt(np.diag(result.solved.model_covariance)[:18])
    assert np.linalg.eigvalsh(added[:18, :18] / np.outer(scale, scale)).min() > -1e-9


@pytest.mark.slow
def test_where_the_noise_is_as_modelled_sigma_is_true_and_hardly_grows():
    """100 draws, camera and lidar: mean NEES/6 in its band of 99 %, [0.85, 1.15]; σ below 1.1 x."""
    values, growth = {"camera": [], "lidar": []}, []
    for seed in range(100):
        made = make_synthetic_setup(seed, BOARDS)
        result = with_cluster_covariance(made, solve_synthetic_setup(made))
        for sensor, list_ in values.items():
            list_.append(nees(result, sensor, result.solved.covariance))
        before, after = result.solved.model_covariance, result.solved.covariance
        growth.append(np.sqrt(np.diag(after)[:12] / np.diag(before)[:12]).mean())
    assert np.mean(growth) < 1.1
    for list_ in values.values():
        assert 0.85 < np.mean(list_) < 1.15


@pytest.mark.slow
def test_where_each_placement_has_an_error_that_is_not_modelled_sigma_is_true():
    """30 draws, ranges off by 4 mm and outlines by 0.03°: NEES/6 in [0.7, 1.5], over 2 without."""
    with_, without = [], []
    for seed in range(30):
        made = with_errors_of_placements(make_synthetic_setup(seed, BOARDS), seed)
        result = with_cluster_covariance(made, solve_synthetic_setup(made))
        with_.append(nees(result, "lidar", result.solved.covariance))
        without.append(nees(result, "lidar", result.solved.model_covariance))
    assert np.mean(without) > 2.0
    assert 0.7 < np.mean(with_) < 1.5
