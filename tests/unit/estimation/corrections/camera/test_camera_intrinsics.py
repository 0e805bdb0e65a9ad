"""Parameters of a camera as numbers of the estimate: found where views tell them, else refused."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.correction_selection import estimate_with_corrections
from calib.estimation.corrections.camera.camera_intrinsics import (
    get_intrinsics_estimate,
    intrinsics_parameter_names,
)
from calib.geometry.se3 import invert_pose, se3_exp
from calib.sensors.camera.camera_model import CameraModel
from helpers import synthetic_setup
from helpers.synthetic_setup import SyntheticWorld, make_synthetic_setup

LIMITS = {
    "max_rounds": 40,
    "tolerance_m": 1e-7,
    "tolerance_rad": 1e-7,
    "initial_noise_factor": 300.0,
}
START = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in synthetic_setup.TRUE_POSES.items()}
TRUE = CameraModel("radtan", (808.0, 806.0, 455.0, 345.0, -0.12, 0.03, 0.001, -0.0005), (900, 700))


def estimated(n, camera=TRUE, seed=0):
    """(Setup, Result) of n placements of a board before a camera that is not as stated."""
    made = replace(
        make_synthetic_setup(seed, [("board", None)] * n, SyntheticWorld(camera=camera)),
        estimable_intrinsics={"camera": 8},
    )
    return estimate_with_corrections(made, START, {"intrinsics": True}, **LIMITS)[:2]


@pytest.mark.parametrize("seed", range(3))
def test_of_thirty_views_all_eight_parameters_are_found_within_3_5_sigma(seed):
    made, result = estimated(30, seed=seed)
    params, sigma, _ = get_intrinsics_estimate(made, result, "camera")
    assert (np.abs(params - np.array(TRUE.params[:8])) < 3.5 * sigma).all()
    assert sigma[0] < 1.0 and sigma[2] < 2.0


def test_poses_are_then_free_of_the_lens():
    _, wrong = estimated(30)
    off = invert_pose(synthetic_setup.TRUE_POSES["camera"]) @ wrong.state.T_robot_sensor["camera"]
    assert np.linalg.norm(off[:3, 3]) < 0.003


def test_one_view_does_not_tell_a_lens_and_says_so():
    made, result = estimated(1)
    assert get_intrinsics_estimate(made, result, "camera") is None
    assert (
        "not estimated" in made.estimable_intrinsics["camera"]
        and "tilted to all sides" in made.estimable_intrinsics["camera"]
    )


def test_parameters_that_the_config_leaves_out_stay_zero():
    """radtan's k3, the ninth, which `params` of eight numbers does not state."""
    made, result = estimated(10)
    assert len(get_intrinsics_estimate(made, result, "camera")[0]) == 8
    assert intrinsics_parameter_names(TRUE, 8) == ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
