"""Boards that are bowed and twisted: the shape is estimated where the data demand it, and true."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.correction_selection import estimate_with_corrections
from calib.estimation.corrections.board_shape import BOARD_SHAPE
from calib.estimation.corrections.correction_estimate import find_correction_estimate
from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.geometry.se3 import invert_pose, se3_exp, se3_log
from helpers import synthetic_setup
from helpers.synthetic_setup import (
    BOARD_TARGET,
    SyntheticWorld,
    make_synthetic_setup,
    warp_board,
)

LAYOUT = [("board", None)] * 10
LIMITS = {
    "max_rounds": 40,
    "tolerance_m": 1e-7,
    "tolerance_rad": 1e-7,
    "initial_noise_factor": 100.0,
}
START = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in synthetic_setup.TRUE_POSES.items()}
AUTO, OFF = {"board_shape": "auto"}, {"board_shape": False}
BOWED, TWISTED = (0.005, 0.0, 0.0), (0.0, 0.002, 0.002)  # m
FULL_TURN_OF_CHI2 = 22.5  # 99.9 % of six


def estimated(warp, seed=0, wanted=AUTO, sensors=("camera", "lidar")):
    """(Setup, Result, suspicions) of a board of that shape, seen by some of the sensors."""
    made = make_synthetic_setup(seed, LAYOUT, SyntheticWorld(targets=warp_board(*warp)))
    made = replace(
        made,
        models={n: m for n, m in made.models.items() if n in sensors},
        groups=[g for g in made.groups if g.sensor in sensors],
    )
    start = {n: T for n, T in START.items() if n in sensors}
    return estimate_with_corrections(made, start, wanted, **LIMITS)


def pose_nees(made, result, sensor):
    """Squared error of a sensor's pose in its σ, of six degrees of freedom."""
    at = 6 * sorted(made.models).index(sensor)
    spread = covariance_from_information(result.solve_result.information)[at : at + 6, at : at + 6]
    truth = synthetic_setup.TRUE_POSES[sensor]
    off = se3_log(invert_pose(truth) @ result.state.T_robot_sensor[sensor])
    return float(off @ np.linalg.solve(spread, off))


@pytest.mark.parametrize("warp", [BOWED, TWISTED])
def test_a_warped_board_is_estimated_to_4_sigma_and_half_a_millimetre(warp):
    made, result, suspected = estimated(warp)
    shape = find_correction_estimate(made, result, BOARD_SHAPE, "board")
    assert (np.abs(shape.values - warp) < 4 * shape.sigma).all() and shape.sigma.max() < 0.0005
    assert suspected == []
    for sensor in ("camera", "lidar"):
        assert pose_nees(made, result, sensor) < FULL_TURN_OF_CHI2


@pytest.mark.parametrize("sensor", ["camera", "lidar"])
def test_one_sensor_alone_shows_a_bow_of_5_mm(sensor):
    made, result, _ = estimated(BOWED, sensors=(sensor,))
    shape = find_correction_estimate(made, result, BOARD_SHAPE, "board")
    assert abs(shape.values[0] - 0.005) < 4 * shape.sigma[0] < 0.004
    assert pose_nees(made, result, sensor) < FULL_TURN_OF_CHI2


@pytest.mark.parametrize("seed", range(3))
def test_of_a_flat_board_no_shape_is_estimated(seed):
    made, _, suspected = estimated((0.0, 0.0, 0.0), seed)
    assert made.corrections == () and suspected == []


def test_with_the_option_off_the_bow_is_named_with_its_size_and_the_key_that_mends_it():
    made, _, suspected = estimated(BOWED, wanted=OFF)
    assert made.corrections == ()
    first = suspected[0]
    assert (first["name"], first["subject"]) == (BOARD_SHAPE, "board")
    assert first["description"].startswith("board is not flat: bowed along its x by ")
    assert "(middle nearer)" in first["description"] and "twist" not in first["description"]
    assert first["estimate"][0] == pytest.approx(0.005, abs=4 * first["sigma"][0])
    assert first["remedy"].startswith("set solve.estimate.board_shape: auto")


def test_a_board_whose_config_states_no_flatness_is_taken_as_flat():
    made = make_synthetic_setup(0, LAYOUT, SyntheticWorld(targets=warp_board(*BOWED)))
    made = replace(made, targets=made.targets | {"board": replace(BOARD_TARGET, flatness=None)})
    made, _, suspected = estimate_with_corrections(made, START, AUTO, **LIMITS)
    assert BOARD_SHAPE not in {c.name for c in made.corrections}
    assert BOARD_SHAPE not in {s["name"] for s in suspected}


@pytest.mark.slow
@pytest.mark.parametrize("warp", [BOWED, TWISTED])
def test_over_20_draws_the_errors_are_as_large_as_their_sigma(warp):
    """NEES/6 of both poses within its band of 99 % for 20 draws, [0.7, 1.35]; the shape's too."""
    nees = {"camera": [], "lidar": [], "shape": []}
    for seed in range(20):
        made, result, _ = estimated(warp, seed)
        for sensor in ("camera", "lidar"):
            nees[sensor].append(pose_nees(made, result, sensor) / 6)
        shape = find_correction_estimate(made, result, BOARD_SHAPE, "board")
        off = shape.values - warp
        nees["shape"].append(float(off @ np.linalg.solve(shape.covariance, off)) / 3)
    assert 0.7 < np.mean(nees["camera"]) < 1.35
    assert 0.7 < np.mean(nees["lidar"]) < 1.35
    assert 0.55 < np.mean(nees["shape"]) < 1.6  # 20 draws of three
