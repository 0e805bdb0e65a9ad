"""Whole runs against a known truth: how near the result is, and whether its σ says so."""

import json

import numpy as np
import pytest

from calib.geometry.se3 import invert_pose, se3_log
from helpers.small_run import run_to_completion, simulate_into

pytestmark = pytest.mark.pipeline

NOISE = (
    "--range-noise-m 0.01 --image-noise 1.8 --mcs-noise-m 0.00015 --mcs-noise-deg 0.02"
    " --mcs-bias-m 0.0001 --mcs-bias-deg 0.01"
)
OUTPUT = "results/sim/calibration.json"


def errors(folder):
    """{sensor: (twist of the error (6,), its covariance (6, 6))} of a finished run."""
    truth = json.loads((folder / "truth.json").read_text())["sensors"]
    found = json.loads((folder / OUTPUT).read_text())["sensors"]
    out = {}
    for name, sensor in found.items():
        T = np.array(truth[name]["T_robot_sensor"]["matrix"])
        T_found = np.array(sensor["T_robot_sensor"]["matrix"])
        out[name] = se3_log(invert_pose(T) @ T_found), np.array(sensor["covariance"])
    return out


def size(error):
    """Translation error, mm, and geodesic rotation error, deg, of a twist."""
    return 1e3 * np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    folder = simulate_into(tmp_path_factory.mktemp("exact"), "--placements 10 --seed 1")
    run_to_completion(folder, OUTPUT)
    return folder


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    folder = simulate_into(tmp_path_factory.mktemp("noisy"), f"--placements 10 --seed 2 {NOISE}")
    run_to_completion(folder, OUTPUT)
    return folder


@pytest.mark.slow
def test_the_first_guess_is_off_by_centimetres_and_degrees(exact):
    for sensor in json.loads((exact / "truth.json").read_text())["sensors"].values():
        guess, true = (np.array(sensor[k]["matrix"]) for k in ("guess", "T_robot_sensor"))
        millimetres, degrees = size(se3_log(invert_pose(true) @ guess))
        assert millimetres > 5 and degrees > 1


@pytest.mark.slow
def test_without_noise_the_lidar_is_right_to_0_05_mm_and_0_002_deg(exact):
    millimetres, degrees = size(errors(exact)["velodyne"][0])
    assert millimetres < 0.05 and degrees < 0.002


@pytest.mark.slow
def test_without_noise_the_camera_is_right_to_0_1_mm_and_0_005_deg(exact):
    millimetres, degrees = size(errors(exact)["camera"][0])
    assert millimetres < 0.1 and degrees < 0.005


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ["camera", "velodyne"])
def test_with_noise_the_error_is_within_3_sigma_in_every_direction(noisy, sensor):
    error, covariance = errors(noisy)[sensor]
    assert (np.abs(error) < 3 * np.sqrt(np.diag(covariance))).all()
    # 99.9 % of the chi-square distribution with six degrees of freedom.
    assert error @ np.linalg.solve(covariance, error) < 22.5


@pytest.mark.slow
def test_with_noise_sigma_is_below_a_millimetre_and_not_below_the_mcs_bias_averaged(noisy):
    for _, covariance in errors(noisy).values():
        sigma = np.sqrt(np.diag(covariance))
        assert 0.0001 / np.sqrt(20) < sigma[:3].max() < 0.001


@pytest.mark.slow
def test_the_range_noise_and_the_corner_noise_are_found(noisy):
    noise = json.loads((noisy / OUTPUT).read_text())["noise"]["sensors"]
    assert noise["velodyne"]["target_surface"] == pytest.approx(0.01, rel=0.03)
    assert noise["camera"]["pattern_corner"] < 0.015


@pytest.mark.slow
def test_all_placements_of_both_targets_are_used(exact):
    sensors = json.loads((exact / OUTPUT).read_text())["sensors"]
    assert sensors["camera"]["placements"] == 10
    assert sensors["velodyne"]["placements"] >= 19


@pytest.mark.slow
@pytest.mark.parametrize(
    "warp",
    [(0.005, 0.0, 0.0), (0.0, 0.002, 0.002)],
    ids=["bowed by 5 mm", "bowed by 2 mm and twisted by 2 mm"],
)
def test_poses_by_a_warped_board_are_within_their_sigma_and_its_shape_is_found(tmp_path, warp):
    bow_x, bow_y, twist = warp
    folder = simulate_into(
        tmp_path,
        f"--placements 10 --seed 4 --targets board --camera-hz 3 --sector-deg 60 {NOISE}"
        f" --board-bow-x-m {bow_x} --board-bow-y-m {bow_y} --board-twist-m {twist}",
    )
    run_to_completion(folder, OUTPUT)
    shape = json.loads((folder / OUTPUT).read_text())["board_shapes"]["board"]
    off, sigma = np.subtract(shape["estimate"], warp), np.array(shape["sigma"])
    assert (np.abs(off) < 3 * sigma).all() and sigma.max() < 0.0005
    for error, covariance in errors(folder).values():
        assert error @ np.linalg.solve(covariance, error) < 22.5  # 99.9 % of six
        assert np.linalg.norm(error[:3]) < 0.001
