"""A program that follows the first advice of the verdict, {file, key, value}, gets a right pose."""

import json

import numpy as np
import pytest

from benchmarking.fault_matrix.row_measurement import apply_change
from helpers.small_run import run_to_completion, simulate_into

pytestmark = [pytest.mark.pipeline, pytest.mark.slow]

LOG = (
    "--rig sim --placements 9 --hold-s 1 --move-s 0.8 --camera-hz 4 --camera-info --seed 4 "
    "--range-noise-m 0.01 --image-noise 1.8 --mcs-noise-m 0.00015 --mcs-noise-deg 0.02"
)


def judged(folder):
    """Verdict, and by sensor the largest error of the pose in its σ, m or rad."""
    run_to_completion(folder, "results/sim/verdict.json")
    verdict = json.loads((folder / "results/sim/verdict.json").read_text())
    found = json.loads((folder / "results/sim/calibration.json").read_text())["sensors"]
    true = json.loads((folder / "truth.json").read_text())["sensors"]
    errors = {}
    for name, sensor in found.items():
        off = np.linalg.inv(true[name]["T_robot_sensor"]["matrix"])
        off = off @ sensor["T_robot_sensor"]["matrix"]
        turn = np.array([off[2, 1], off[0, 2], off[1, 0]])  # small
        sigma = np.sqrt(np.diag(sensor["covariance"]))
        errors[name] = float(np.abs(np.append(off[:3, 3], turn) / sigma).max())
    return verdict, errors


def test_a_knock_of_the_markers_is_calibrated_by_its_own_advice(tmp_path):
    """A knock of 18 mm and 0.8° after the fourth of nine placements."""
    folder = simulate_into(
        tmp_path / "log", f"{LOG} --knock-m 0.018 --knock-deg 0.8 --knock-after 0.45"
    )
    verdict, _ = judged(folder)
    first = verdict["findings"][0]
    assert verdict["verdict"] != "pass" and first["check"] == "suspected_error"
    assert first["change"]["key"] == "sessions.sim.remounted_at_s"
    apply_change(folder, first["change"])
    verdict, errors = judged(folder)
    assert verdict["verdict"] == "pass", verdict["reasons"]
    assert max(errors.values()) < 4, errors
