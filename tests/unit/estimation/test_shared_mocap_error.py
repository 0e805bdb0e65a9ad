"""Sensors that see one target at once: the error of the MCS is theirs in common and cancels."""

from dataclasses import replace

import numpy as np
import pytest

from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import invert_pose, relative_pose_covariance, se3_exp, se3_log
from helpers import synthetic_setup
from helpers.synthetic_setup import MCS_SIGMA, make_synthetic_setup

LAYOUT = [("board", None)] * 12
LIMITS = {
    "max_rounds": 40,
    "tolerance_m": 1e-7,
    "tolerance_rad": 1e-7,
    "initial_noise_factor": 100.0,
}
START = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in synthetic_setup.TRUE_POSES.items()}
COARSE = 20.0  # times the MCS noise of the other tests: 2 mm, 0.2°


def relative(apart, seed):
    """(error (6,), covariance (6, 6)) of T_camera_lidar with a coarse MCS.

    apart: whether every placement is seen by one of the two alone.
    """
    made = make_synthetic_setup(seed, LAYOUT, mcs_noise_factor=COARSE)
    places = [replace(p, mocap_sigma=COARSE * MCS_SIGMA) for p in made.placements]
    groups = made.groups
    if apart:
        groups = [g for g in groups if (g.sensor == "camera") == (g.placement % 2 == 0)]
    made = replace(made, placements=places, groups=groups)
    result = estimate_poses(made, START, **LIMITS)
    T = [result.state.T_robot_sensor[n] for n in ("camera", "lidar")]
    true = invert_pose(synthetic_setup.TRUE_POSES["camera"]) @ synthetic_setup.TRUE_POSES["lidar"]
    joint = covariance_from_information(result.solve_result.information)[:12, :12]
    spread = relative_pose_covariance(*T, joint)
    return se3_log(invert_pose(true) @ invert_pose(T[0]) @ T[1]), spread


def test_a_coarse_mcs_does_not_limit_what_two_sensors_that_overlap_know_of_each_other():
    """σ of their relative position: a sixth, or less, of that without a common view, and less than
    the MCS's own for one pose, 2 mm."""
    together, alone = (np.sqrt(np.trace(relative(apart, 0)[1][:3, :3])) for apart in (False, True))
    assert together < alone / 6
    assert together < COARSE * MCS_SIGMA[0]


@pytest.mark.slow
def test_with_and_without_a_common_view_the_error_is_by_its_sigma():
    """NEES/6 of 10 draws within the band of 99.9 %, [0.47, 1.80]."""
    for apart in (False, True):
        draws = [relative(apart, seed) for seed in range(10)]
        nees = np.mean([xi @ np.linalg.solve(C, xi) for xi, C in draws]) / 6
        assert 0.47 < nees < 1.80, apart
