"""Sensors that see one target at once: the error of the MCS is theirs in common and cancels."""

from dataclasses import replace

import numpy as np

import synthetic
from calib.estimation import solver
from calib.estimation.nlp.information_matrix import covariance
from calib.geometry import se3
from synthetic import MCS_SIGMA, setup

LAYOUT = [("board", None)] * 12
LIMITS = {"max_rounds": 40, "tolerance_m": 1e-7, "tolerance_rad": 1e-7, "noise": 100.0}
START = {n: T @ se3.se3_exp(np.full(6, 0.005)) for n, T in synthetic.TRUE.items()}
COARSE = 20.0  # times the MCS noise of the other tests: 2 mm, 0.2°


def relative(apart, seed):
    """(error (6,), covariance (6, 6)) of T_camera_lidar with a coarse MCS.

    apart: whether every placement is seen by one of the two alone.
    """
    made = setup(seed, LAYOUT, mcs=COARSE)
    places = [replace(p, sigma=COARSE * MCS_SIGMA) for p in made.placements]
    groups = made.groups
    if apart:
        groups = [g for g in groups if (g.sensor == "camera") == (g.placement % 2 == 0)]
    made = replace(made, placements=places, groups=groups)
    result = solver.estimate(made, START, **LIMITS)
    T = [result.state.T_robot_sensor[n] for n in ("camera", "lidar")]
    true = se3.inverse(synthetic.TRUE["camera"]) @ synthetic.TRUE["lidar"]
    joint = covariance(result.solution.information)[:12, :12]
    spread = se3.covariance_of_relative(*T, joint)
    return se3.se3_log(se3.inverse(true) @ se3.inverse(T[0]) @ T[1]), spread


def test_a_coarse_mcs_does_not_limit_what_two_sensors_that_overlap_know_of_each_other():
    """σ of their relative position: a sixth, or less, of that without a common view, and less than
    the MCS's own for one pose, 2 mm."""
    together, alone = (np.sqrt(np.trace(relative(apart, 0)[1][:3, :3])) for apart in (False, True))
    assert together < alone / 6
    assert together < COARSE * MCS_SIGMA[0]


def test_with_and_without_a_common_view_the_error_is_by_its_sigma():
    """NEES/6 of 10 draws within the band of 99.9 %, [0.47, 1.80]."""
    for apart in (False, True):
        draws = [relative(apart, seed) for seed in range(10)]
        nees = np.mean([xi @ np.linalg.solve(C, xi) for xi, C in draws]) / 6
        assert 0.47 < nees < 1.80, apart
