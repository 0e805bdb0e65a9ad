"""Split halves: placements in two balanced halves, each with its own choices, and their NEES."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.split_halves import (
    MIN_HALF_PLACEMENTS,
    compare_halves,
    estimate_halves,
    sensors_in_halves,
    split_placements,
)
from calib.geometry.se3 import se3_exp
from helpers import synthetic_setup
from helpers.synthetic_setup import N_RINGS, SyntheticWorld, make_synthetic_setup

MIXED = [("board", None)] * 12 + [("cylinder", None)] * 6
LIMITS = {
    "max_rounds": 30,
    "tolerance_m": 1e-6,
    "tolerance_rad": 1e-6,
    "initial_noise_factor": 100.0,
}
START = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in synthetic_setup.TRUE_POSES.items()}
AUTO = {"lidar_corrections": "auto", "target_alignment": "auto"}
BEAMS_OFF_14_MM = SyntheticWorld(range_bias_m=0.014 * (-1.0) ** np.arange(N_RINGS))


def halves_of(made, **settings):
    halves = estimate_halves(made, START, AUTO, **settings, **LIMITS)
    assert halves is not None
    return halves


def test_halves_are_complementary_and_have_the_same_number_of_each_target():
    made = make_synthetic_setup(0, MIXED)
    first, second = split_placements(made)
    assert sorted(first + second) == list(range(18))
    for half in (first, second):
        targets = [made.placements[k].target for k in half]
        assert (targets.count("board"), targets.count("cylinder")) == (6, 3)


def test_the_same_seed_gives_the_same_halves_and_another_seed_others():
    made = make_synthetic_setup(0, MIXED)
    assert split_placements(made, seed=1) == split_placements(made, seed=1)
    assert split_placements(made, seed=1) != split_placements(made, seed=2)


def test_placements_of_one_rest_of_the_robot_stay_together():
    made = make_synthetic_setup(0, MIXED)
    places = [replace(p, robot_rest=k // 3) for k, p in enumerate(made.placements)]
    halves = split_placements(replace(made, placements=places))
    for half in halves:
        assert len(half) == 9 and {k // 3 * 3 + i for k in half for i in range(3)} == set(half)


def test_sensors_with_fewer_than_8_placements_are_not_compared():
    made = make_synthetic_setup(0, MIXED)
    groups = [g for g in made.groups if g.sensor == "lidar" or g.placement < 7]
    made = replace(made, groups=groups)
    halves = split_placements(made)
    assert MIN_HALF_PLACEMENTS == 4 and sensors_in_halves(made, halves) == ["lidar"]
    halves = halves_of(made)
    assert all(set(h.setup.models) == {"camera", "lidar"} for h in halves)
    assert compare_halves(halves, "camera") is None
    assert compare_halves(halves, "lidar") is not None
    assert estimate_halves(make_synthetic_setup(0, MIXED[:7]), START, AUTO, **LIMITS) is None


def test_halves_of_a_lidar_with_faulty_beams_both_adopt_their_correction():
    halves = halves_of(make_synthetic_setup(0, MIXED, BEAMS_OFF_14_MM))
    assert [h.adopted for h in halves] == [{("beam_offsets", "lidar")}] * 2
    assert [h.adopted for h in halves_of(make_synthetic_setup(0, MIXED))] == [frozenset()] * 2


def test_what_the_config_requests_is_not_adopted():
    wanted = {"target_alignment": True}
    sigma = {"board": np.full(6, 0.01)}
    made = replace(make_synthetic_setup(0, MIXED), mount_sigma=sigma)
    halves = estimate_halves(made, START, wanted, **LIMITS)
    assert halves is not None
    for half in halves:
        assert set(half.setup.initial_mounts) == {"board"} and half.adopted == frozenset()


def test_poses_of_halves_that_differ_by_a_known_shift_have_its_nees():
    """The lidar of the second half is moved by 2 σ along each axis of the joint covariance."""
    first, second = halves_of(make_synthetic_setup(0, MIXED))
    covariance = sum(
        h.result.solved.covariance[6:12, 6:12]
        for h in (first, second)  # camera first
    )
    shift = 2 * np.linalg.cholesky(covariance).sum(axis=1)
    T = first.result.state.T_robot_sensor["lidar"] @ se3_exp(shift)
    poses = second.result.state.T_robot_sensor | {"lidar": T}
    state = replace(second.result.state, T_robot_sensor=poses)
    moved = replace(second, result=replace(second.result, state=state))
    comparison = compare_halves((first, moved), "lidar")
    assert comparison is not None and comparison.n_directions == 6
    assert comparison.nees == pytest.approx(24.0, rel=1e-6)
    np.testing.assert_allclose(comparison.shift, shift, atol=1e-12)


def test_directions_that_a_half_does_not_determine_do_not_count():
    """Cylinders with parallel axes leave the rotation about them and the shift along them open."""
    upright = [("cylinder", (0.0, 0.0, 1.0))] * 10
    made = make_synthetic_setup(0, upright)
    comparison = compare_halves(halves_of(made), "lidar")
    assert comparison is not None and comparison.n_directions < 6
    assert comparison.nees / comparison.n_directions < 4.0


@pytest.mark.slow
def test_halves_of_measurements_as_modelled_differ_by_their_sigma():
    """20 draws of camera and lidar: mean NEES/6 within 99 % of its band, [0.70, 1.35]."""
    for sensor in ("camera", "lidar"):
        nees = []
        for seed in range(20):
            comparison = compare_halves(halves_of(make_synthetic_setup(seed, MIXED)), sensor)
            assert comparison is not None
            nees.append(comparison.nees / comparison.n_directions)
        assert 0.70 < np.mean(nees) < 1.35
