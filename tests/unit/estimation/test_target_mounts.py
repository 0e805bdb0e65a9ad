"""Where a target sits in its MCS body, estimated with its prior where the residuals ask for it."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.correction_selection import estimate_with_corrections
from calib.diagnosis.leave_one_out import leave_one_out_rms
from calib.diagnosis.solution_json import target_mounts_json
from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.geometry.se3 import invert_pose, make_pose, rotation_angle, se3_exp, se3_log, so3_exp
from helpers import synthetic_setup
from helpers.synthetic_setup import TARGETS_BY_NAME, SyntheticWorld, make_synthetic_setup

LAYOUT = [("board", None)] * 16 + [("cylinder", None)] * 5
LIMITS = {
    "max_rounds": 30,
    "tolerance_m": 1e-6,
    "tolerance_rad": 1e-6,
    "initial_noise_factor": 100.0,
}
START = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in synthetic_setup.TRUE_POSES.items()}
SIGMA = np.repeat([0.002, np.radians(0.3)], 3)  # the config's default
AUTO = {"target_alignment": "auto"}
OFF = make_pose(so3_exp(np.radians([0.6, -0.6, 0.5])), [0.004, -0.003, 0.0033])


def estimated(mounts, seed=0, wanted=AUTO, layout=LAYOUT):
    """(Setup, Result) of a world with targets off by mounts in their bodies, 6 mm and 1°."""
    made = make_synthetic_setup(seed, layout, SyntheticWorld(T_body_target=mounts))
    made = replace(made, mount_sigma=dict.fromkeys(TARGETS_BY_NAME, SIGMA))
    return estimate_with_corrections(made, START, wanted, **LIMITS)[:2]


def error(result, name):
    """(6,) of a sensor's pose, m and rad."""
    return se3_log(
        invert_pose(synthetic_setup.TRUE_POSES[name]) @ result.state.T_robot_sensor[name]
    )


@pytest.fixture(scope="module")
def draws():
    """[(Setup, Result)] of 12 draws of the noise with a board off by OFF."""
    return [estimated({"board": OFF}, seed) for seed in range(12)]


@pytest.mark.slow
def test_a_board_off_by_6_mm_and_1_deg_is_found_to_half_a_millimetre_and_a_twentieth_degree(draws):
    assert np.linalg.norm(OFF[:3, 3]) == pytest.approx(0.006, rel=0.01)
    assert np.degrees(rotation_angle(OFF)) == pytest.approx(1.0, rel=0.02)
    left = [invert_pose(OFF) @ result.state.mounts["board"] for _, result in draws]
    assert np.sqrt(np.mean([np.sum(T[:3, 3] ** 2) for T in left])) < 5e-4
    assert np.degrees(np.sqrt(np.mean(rotation_angle(np.array(left)) ** 2))) < 0.05


@pytest.mark.slow
def test_poses_and_mount_err_by_their_sigma(draws):
    """NEES/6 over 12 draws, each within its band of 99.9 %: 72 numbers, [0.52, 1.70]."""
    for k in range(3):
        nees = []
        for _, result in draws:
            poses = [error(result, n) for n in sorted(synthetic_setup.TRUE_POSES)]
            left = invert_pose(OFF) @ result.state.mounts["board"]
            off = [*poses, se3_log(left)][k]
            at = slice(6 * k, 6 * k + 6)
            nees.append(
                off
                @ np.linalg.solve(
                    covariance_from_information(result.solve_result.information)[at, at], off
                )
            )
        assert 0.52 < np.mean(nees) / 6 < 1.70


def test_a_board_that_sits_where_it_is_said_to_stays_there():
    made, _ = estimated({})
    assert made.initial_mounts == {}


def test_with_the_option_off_it_stays_where_it_is_said_to():
    made, _ = estimated({"board": OFF}, wanted={"target_alignment": False})
    assert made.initial_mounts == {}


def test_what_placements_left_out_say_agrees_better_with_the_estimated_mount():
    wrong, at_first = estimated({"board": OFF}, wanted={})
    made, result = estimated({"board": OFF})
    assert leave_one_out_rms(made, result) < 0.5 * leave_one_out_rms(wrong, at_first)


def test_where_the_data_tell_nothing_of_it_the_prior_stands():
    """The place of a cylinder along its own axis: a σ of 2 mm before and after."""
    off = make_pose(None, [0.0, 0.006, 0.0])
    made, result = estimated(
        {"cylinder": off}, layout=[("board", None)] * 6 + [("cylinder", None)] * 9
    )
    assert list(made.initial_mounts) == ["cylinder"]
    first = 6 * len(made.models)
    sigma = np.sqrt(np.diag(covariance_from_information(result.solve_result.information)))[
        first : first + 6
    ]
    assert sigma[0] == pytest.approx(0.002, rel=0.05) and sigma[3] == pytest.approx(
        SIGMA[3], rel=0.05
    )
    assert sigma[1] < 0.0005
    assert result.state.mounts["cylinder"][1, 3] == pytest.approx(0.006, abs=3 * sigma[1])


def test_the_results_state_the_shift_from_the_config_and_its_prior():
    made, result = estimated({"board": OFF})
    told = target_mounts_json(made, result, {"targets": {"board": {}, "cylinder": {}}})
    assert told["cylinder"] is None
    np.testing.assert_allclose(told["board"]["shift"], se3_log(OFF), atol=1e-3)
    np.testing.assert_array_equal(told["board"]["prior_sigma"], SIGMA)
