"""Logs that cannot tell everything: what stays open, in words, and what to record next."""

import json

import numpy as np
import pytest

from calib.geometry.se3 import invert_pose, se3_log
from helpers.small_run import SMALL_ARGUMENTS, run_to_completion, simulate_into

pytestmark = pytest.mark.pipeline

NOISE = "--range-noise-m 0.005 --image-noise 1.8 --mcs-noise-m 0.0001 --mcs-noise-deg 0.01"


def told(folder):
    """(verdict.json, calibration.json) of a log."""
    run_to_completion(folder, "results/sim/verdict.json")
    home = folder / "results/sim"
    return [json.loads((home / f"{n}.json").read_text()) for n in ("verdict", "calibration")]


@pytest.fixture(scope="module")
def resting(tmp_path_factory):
    """One placement, and nothing that moves."""
    arguments = SMALL_ARGUMENTS.replace("--placements 4", "--placements 1")
    return told(simulate_into(tmp_path_factory.mktemp("resting"), arguments))


@pytest.mark.slow
def test_a_single_placement_fails_and_says_to_hold_targets_in_more_places(resting):
    verdict, calibration = resting
    assert verdict["verdict"] == "fail"
    assert verdict["reasons"][0] == "camera: placements 1, fail below 3"
    assert verdict["findings"][0]["remedy"].startswith("Hold targets still in more places")
    advice = calibration["sensors"]["camera"]["recording_advice"]
    assert advice.startswith("Hold a target still in at least 3 different places")


@pytest.mark.slow
def test_where_nothing_moves_no_clock_is_told(resting):
    for sensor in resting[1]["sensors"].values():
        assert sensor["time_offset_s"] is None
        assert sensor["time_offset_note"] == "not observable: no relative motion"


@pytest.fixture(scope="module")
def upright(tmp_path_factory):
    """Robot and board turn about the vertical only; the board sits 4 mm and 0.5° off in its body,
    as its alignment_sigma says."""
    arguments = SMALL_ARGUMENTS.replace("--placements 4", "--placements 6")
    arguments += f" --targets board --upright --mount-m 0.004 --mount-deg 0.5 {NOISE}"
    folder = simulate_into(tmp_path_factory.mktemp("upright"), arguments)
    return *told(folder), json.loads((folder / "truth.json").read_text())


@pytest.mark.slow
def test_rotation_about_one_axis_leaves_the_mount_to_its_prior_and_asks_to_tilt_the_target(upright):
    (found,) = [f for f in upright[0]["findings"] if f["check"] == "target_mount"]
    assert found["level"] == "warn"
    assert "T_body_target of board is undetermined in translation along y" in found["text"]
    assert found["remedy"].startswith("Tilt board by 30° or more about two other axes")


@pytest.mark.slow
def test_what_only_the_prior_tells_stands_in_the_sigma_of_the_sensors(upright):
    """Both sensors are as far off along the vertical as the board sits off: 4 mm, by their σ."""
    _, calibration, truth = upright
    for name, sensor in calibration["sensors"].items():
        T = np.array(truth["sensors"][name]["T_robot_sensor"]["matrix"])
        off = se3_log(invert_pose(T) @ sensor["T_robot_sensor"]["matrix"])
        spread = np.array(sensor["covariance"])
        assert off @ np.linalg.solve(spread, off) / 6 < 2.8, name  # 1 % of honest ones exceed it
        assert np.sqrt(np.trace(spread[:3, :3])) == pytest.approx(0.004, rel=0.1), name
        assert sensor["least_certain"]["direction"] == "translation along z of the robot body"
