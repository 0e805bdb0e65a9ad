"""Ranges that depend on the intensity of a return: the slope is found, and the pose is right."""

import numpy as np
import pytest

from calib.diagnosis.correction_selection import estimate_with_corrections
from calib.estimation.corrections.correction_estimate import find_correction_estimate
from calib.geometry.se3 import invert_pose, se3_exp, se3_log
from helpers import synthetic_setup
from helpers.synthetic_setup import SyntheticWorld, make_synthetic_setup

PLACEMENTS = [("board", None)] * 6 + [("cylinder", None)] * 4
LIMITS = {
    "max_rounds": 30,
    "tolerance_m": 1e-6,
    "tolerance_rad": 1e-6,
    "initial_noise_factor": 100.0,
}
START = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in synthetic_setup.TRUE_POSES.items()}
WEAK_M = 0.02  # at intensity 0 rather than 100; at 5 rather than 95 it is 90 % of that


def refine(world, wanted="auto"):
    setup = make_synthetic_setup(0, PLACEMENTS, world)
    return estimate_with_corrections(setup, START, {"lidar_corrections": wanted}, **LIMITS)


@pytest.fixture(scope="module")
def weak_returns_long():
    return refine(SyntheticWorld(weak_range_m=WEAK_M))


def test_weak_returns_that_read_20_mm_long_are_estimated(weak_returns_long):
    setup, result, suspected = weak_returns_long
    found = find_correction_estimate(setup, result, "intensity_ranges", "lidar")
    assert found is not None and [c.name for c in setup.corrections] == ["intensity_ranges"]
    assert abs(found.values[0] - 0.9 * WEAK_M) < 3.5 * found.sigma[0] < 0.004
    words = found.correction.describe(found.values, found.sigma)
    assert "mm longer at intensity 5" in words
    assert suspected == []


def test_the_pose_is_then_within_3_5_sigma(weak_returns_long):
    setup, result, _ = weak_returns_long
    truth = synthetic_setup.TRUE_POSES["lidar"]
    off = se3_log(invert_pose(truth) @ result.state.T_robot_sensor["lidar"])
    at = slice(6 * sorted(setup.models).index("lidar"), None)
    sigma = np.sqrt(np.diag(result.solved.covariance))[at][:6]
    assert np.abs(off / sigma).max() < 3.5


def test_where_it_must_not_be_estimated_it_is_named_first_with_the_key_to_set():
    setup, _, suspected = refine(SyntheticWorld(weak_range_m=WEAK_M), wanted=False)
    assert setup.corrections == ()
    first = suspected[0]
    assert (first["name"], first["subject"]) == ("intensity_ranges", "lidar")
    assert first["change"]["key"] == "solve.estimate.lidar_corrections"


@pytest.mark.parametrize("weak_range_m", [0.0, None])
def test_ranges_that_do_not_depend_on_intensity_or_do_not_tell_it_need_no_correction(weak_range_m):
    setup, _, suspected = refine(SyntheticWorld(weak_range_m=weak_range_m))
    assert setup.corrections == () and suspected == []
