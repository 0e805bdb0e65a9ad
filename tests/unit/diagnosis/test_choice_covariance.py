"""Covariance by choice: what halves that adopt other corrections would move the result by."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.covariance.choice_covariance import choice_covariance
from calib.diagnosis.error_search.supported_corrections import select_corrections
from calib.diagnosis.split_halves import HalfEstimate
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import invert_pose, se3_exp, se3_log
from helpers import synthetic_setup
from helpers.synthetic_setup import N_RINGS, SyntheticWorld, make_synthetic_setup

MIXED = [("board", None)] * 7 + [("cylinder", None)] * 3
LIMITS = {
    "max_rounds": 30,
    "tolerance_m": 1e-6,
    "tolerance_rad": 1e-6,
    "initial_noise_factor": 100.0,
}
START = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in synthetic_setup.TRUE_POSES.items()}
BEAMS = frozenset({("beam_offsets", "lidar")})
NONE = frozenset()


@pytest.fixture(scope="module")
def with_beams():
    """(Setup before, (Setup, Result)) of a lidar whose beams err by 14 mm, rightly corrected."""
    world = SyntheticWorld(range_bias_m=0.014 * (-1.0) ** np.arange(N_RINGS))
    made = make_synthetic_setup(0, MIXED, world)
    estimate = select_corrections(made, START, {"lidar_corrections": "auto"}, **LIMITS)
    assert [c.name for c in estimate[0].corrections] == ["beam_offsets"]
    return made, estimate


def added(with_beams, *adopted):
    made, estimate = with_beams
    halves = tuple(HalfEstimate(*estimate, chosen) for chosen in adopted)
    return choice_covariance(made, estimate, halves, **LIMITS)


def test_beams_that_truly_err_and_that_both_halves_adopt_add_nothing(with_beams):
    assert not added(with_beams, BEAMS, BEAMS).any()
    assert not choice_covariance(*with_beams, None, **LIMITS).any()


def test_a_choice_of_one_half_adds_half_of_what_it_moves_squared(with_beams):
    """δ is from the pose with the correction to the pose that is estimated without, to 1 %."""
    made, (_, result) = with_beams
    bare = estimate_poses(made, START, **LIMITS)
    shifts = [
        se3_log(invert_pose(result.state.T_robot_sensor[n]) @ bare.state.T_robot_sensor[n])
        for n in ("camera", "lidar")
    ]
    delta = np.concatenate(shifts)
    found = added(with_beams, BEAMS, NONE)
    assert np.linalg.norm(delta[6:9]) > 1e-4
    np.testing.assert_allclose(found, np.outer(delta, delta) / 2, atol=0.01 * delta @ delta / 2)
    np.testing.assert_allclose(found, added(with_beams, NONE, BEAMS), atol=1e-15)


@pytest.mark.slow
def test_a_mount_that_one_half_adopts_is_compared_with_the_configured_one():
    """The board sits 12 mm, 1° from where the config says: ½ of 12 mm squared, in x, to 20 %."""
    T = se3_exp(np.array([0.012, 0, 0, 0.017, 0, 0]))
    made = make_synthetic_setup(0, MIXED, SyntheticWorld(T_body_target={"board": T}))
    made = replace(made, mount_sigma={"board": np.repeat([0.01, 0.02], 3)})
    estimate = select_corrections(made, START, {"target_alignment": "auto"}, **LIMITS)
    mounted = frozenset({("mount", "board")})
    assert set(estimate[0].initial_mounts) == {"board"}
    halves = (HalfEstimate(*estimate, mounted), HalfEstimate(*estimate, NONE))
    found = choice_covariance(made, estimate, halves, **LIMITS)
    assert found.shape == (18, 18)
    assert found[12, 12] == pytest.approx(0.012**2 / 2, rel=0.2)
