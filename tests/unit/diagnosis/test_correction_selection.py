"""Numbers of the sensors beside their poses: taken in when the residuals ask for them, and true."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis import correction_selection
from calib.diagnosis.correction_selection import estimate_with_corrections, sensor_corrections_json
from calib.diagnosis.covariance.consider_covariance import (
    common_range_sigmas,
    with_consider_covariance,
)
from calib.diagnosis.split_halves import estimate_halves, split_placements
from calib.estimation.corrections.correction_catalog import list_testable_corrections
from calib.estimation.estimate_state import initial_state
from calib.estimation.measurement_assignment import assign_measurements
from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.estimation.pose_chain import model_with_corrections
from calib.estimation.round_solution import (
    build_nlp,
    cameras_at_estimate,
    correction_derivatives,
    linearize_measurements,
    solve_round,
    targets_at_estimate,
)
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import invert_pose, se3_exp, se3_log, so3_exp
from calib.sensors.lidar.lidar_model import LidarModel
from helpers import synthetic_setup
from helpers.synthetic_setup import LIDAR_MODEL, N_RINGS, SyntheticWorld, make_synthetic_setup

MIXED = [("board", None)] * 7 + [("cylinder", None)] * 3
SIGNS = (-1.0) ** np.arange(N_RINGS)
LIMITS = {
    "max_rounds": 30,
    "tolerance_m": 1e-6,
    "tolerance_rad": 1e-6,
    "initial_noise_factor": 100.0,
}
START = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in synthetic_setup.TRUE_POSES.items()}
AUTO, OFF = {"lidar_corrections": "auto"}, {"lidar_corrections": False}


def refined(world, seed=0, wanted=AUTO):
    """(Setup, Result, suspicions) of measurements of a World."""
    return estimate_with_corrections(
        make_synthetic_setup(seed, MIXED, world), START, wanted, **LIMITS
    )


def error(result, name):
    """(6,) of a sensor's pose, m and rad."""
    return se3_log(
        invert_pose(synthetic_setup.TRUE_POSES[name]) @ result.state.T_robot_sensor[name]
    )


def spread(result, made, name):
    """(6, 6) covariance of a sensor's pose."""
    at = 6 * sorted(made.models).index(name)
    return covariance_from_information(result.solve_result.information)[at : at + 6, at : at + 6]


def lidar_of(made, result):
    """The lidar as its returns show it."""
    group = next(g for g in made.groups if g.kind == "target_surface")
    return model_with_corrections(made, result.state, group)


# --- what is taken in


@pytest.mark.parametrize("seed", range(3))
def test_of_a_lidar_without_fault_nothing_is_estimated_but_its_pose(seed):
    made, result, suspected = refined(SyntheticWorld(), seed)
    assert made.corrections == () and suspected == []


def test_single_beams_off_by_14_mm_are_found_to_3_mm_and_suspected_no_more():
    made, result, suspected = refined(SyntheticWorld(range_bias_m=0.014 * SIGNS))
    assert [h.name for h in made.corrections] == ["beam_offsets"]
    offsets = lidar_of(made, result).range_offsets
    np.testing.assert_allclose(offsets, 0.014 * SIGNS, atol=0.003)
    assert suspected == [] and result.has_converged


RANGES_20_MM_LONG = SyntheticWorld(range_bias_m=np.full(N_RINGS, 0.02))


def test_a_bias_of_all_ranges_is_named_and_never_estimated_by_itself():
    made, _, suspected = refined(RANGES_20_MM_LONG)
    assert made.corrections == ()
    assert [s["name"] for s in suspected] == ["range_bias"]
    assert abs(suspected[0]["estimate"][0] - 0.02) < 0.001
    assert "solve.estimate.range_bias: true" in suspected[0]["remedy"]


@pytest.mark.parametrize("world", [RANGES_20_MM_LONG, SyntheticWorld()])
def test_a_bias_of_all_ranges_is_estimated_where_the_config_asks_for_it(world):
    made, result, suspected = refined(world, wanted=AUTO | {"range_bias": True})
    (told,) = sensor_corrections_json(made, result, "lidar")
    assert (told["name"], told["prior_sigma"]) == ("range_bias", [LIDAR_MODEL.beam_range_sigma])
    assert abs(told["estimate"][0] - world.range_bias_m[0]) < 2.5 * told["sigma"][0]
    assert suspected == []


def test_a_bias_of_all_ranges_is_found_to_2_sigma_of_its_own():
    made, result, _ = refined(RANGES_20_MM_LONG, wanted=AUTO | {"range_bias": True})
    (told,) = sensor_corrections_json(made, result, "lidar")
    assert told["name"] == "range_bias" and "too long" in told["description"]
    assert abs(told["estimate"][0] - 0.02) < 2 * told["sigma"][0] < 0.002


BEAMS_OFF_14_MM = SyntheticWorld(range_bias_m=0.014 * SIGNS)


def test_beams_that_one_half_of_the_placements_does_not_show_are_named_and_not_estimated():
    setup = make_synthetic_setup(0, MIXED, BEAMS_OFF_14_MM)
    first, second = estimate_halves(setup, START, AUTO, **LIMITS)
    assert first.adopted == second.adopted == {("beam_offsets", "lidar")}
    halves = (first, replace(second, adopted=frozenset()))
    made, _, (told,) = estimate_with_corrections(setup, START, AUTO, halves=halves, **LIMITS)
    assert made.corrections == ()
    assert told["description"].endswith("(not estimated: only one half of the data shows it alone)")
    assert (told["name"], told["adopted_in_halves"]) == ("beam_offsets", 1)


def test_beams_that_err_in_one_half_of_the_placements_alone_are_not_estimated():
    first, _ = split_placements(make_synthetic_setup(0, MIXED))
    off, good = (make_synthetic_setup(0, MIXED, w) for w in (BEAMS_OFF_14_MM, SyntheticWorld()))
    groups = [
        a if a.placement in first else b for a, b in zip(off.groups, good.groups, strict=True)
    ]
    setup = replace(good, groups=groups)
    assert estimate_with_corrections(setup, START, AUTO, **LIMITS)[0].corrections == ()


def test_with_7_placements_beams_that_err_are_named_and_not_estimated():
    setup = make_synthetic_setup(0, MIXED[:7], BEAMS_OFF_14_MM)
    made, _, (told,) = estimate_with_corrections(setup, START, AUTO, **LIMITS)
    assert made.corrections == ()
    assert "(not estimated: lidar has fewer than 8 placements" in told["description"]
    assert (told["name"], told["adopted_in_halves"]) == ("beam_offsets", None)


def test_halves_that_are_there_already_are_not_estimated_again(monkeypatch):
    setup = make_synthetic_setup(0, MIXED, BEAMS_OFF_14_MM)
    halves = estimate_halves(setup, START, AUTO, **LIMITS)
    monkeypatch.setattr(correction_selection, "estimate_halves", None)
    made, _, _ = estimate_with_corrections(setup, START, AUTO, halves=halves, **LIMITS)
    assert [c.name for c in made.corrections] == ["beam_offsets"]


def test_with_the_option_off_the_fault_is_named_and_not_estimated():
    made, _, suspected = refined(SyntheticWorld(range_bias_m=0.014 * SIGNS), wanted=OFF)
    assert made.corrections == ()
    assert [s["name"] for s in suspected] == ["beam_offsets"]


def test_estimated_beams_bring_back_the_noise_and_the_sigma_of_a_lidar_without_the_fault():
    """The pose with beams off by 14 mm, against that of the same draws without: within 1.2 σ."""
    _, clean, _ = refined(SyntheticWorld())
    made, result, _ = refined(SyntheticWorld(range_bias_m=0.014 * SIGNS))
    noise = result.state.noise["lidar", "target_surface"].total
    assert noise == pytest.approx(clean.state.noise["lidar", "target_surface"].total, rel=0.1)
    sigma = np.sqrt(np.diag(spread(result, made, "lidar")))
    assert np.abs(error(result, "lidar") - error(clean, "lidar")).max() < 1.2 * sigma.max()


@pytest.mark.slow
def test_what_is_estimated_besides_is_in_the_covariance_of_the_pose():
    """20 draws with both faults: NEES/6 of the lidar within its band of 99 %, [0.7, 1.35]."""
    world, nees = SyntheticWorld(range_bias_m=0.012 * SIGNS + 0.01), []
    for seed in range(20):
        made, result, _ = refined(world, seed, AUTO | {"range_bias": True})
        off = error(result, "lidar")
        nees.append(off @ np.linalg.solve(spread(result, made, "lidar"), off) / 6)
    assert 0.7 < np.mean(nees) < 1.35


def test_sigma_knows_what_beams_err_by_in_common_by_how_the_pose_would_follow():
    """Of a lidar whose beams err by 14 mm: its covariance grows by σ² k kᵀ, k being by how much the
    pose moves when all ranges are shortened by 0.2 mm and everything is estimated anew."""
    made = make_synthetic_setup(0, MIXED, SyntheticWorld(range_bias_m=0.014 * SIGNS))
    (beams,) = [h for h in list_testable_corrections(made) if h.name == "beam_offsets"]
    made = replace(made, corrections=(beams,))
    result = estimate_poses(made, START, **LIMITS)
    longer = made.models | {"lidar": replace(LIDAR_MODEL, range_bias=2e-4)}
    other = estimate_poses(replace(made, models=longer), START, **LIMITS)
    T, moved = (r.state.T_robot_sensor["lidar"] for r in (result, other))
    k = se3_log(invert_pose(T) @ moved) / 2e-4
    theta = result.state.correction_values
    sigma = np.sqrt(np.mean(theta**2) / (len(theta) + 1))
    grown = spread(with_consider_covariance(made, result), made, "lidar") - spread(
        result, made, "lidar"
    )
    np.testing.assert_allclose(grown, sigma**2 * np.outer(k, k), atol=0.05 * grown.max())
    assert grown[:3, :3].trace() > 0.0005**2
    assert common_range_sigmas(made, result.state) == {"lidar": pytest.approx(sigma)}
    bias = next(h for h in list_testable_corrections(made) if h.name == "range_bias")
    with_bias = replace(made, corrections=(beams, bias))
    assert common_range_sigmas(with_bias, result.state) == {}


# --- the programme with such numbers


def test_the_programme_finds_the_same_with_the_numbers_as_with_the_data_mended_by_hand():
    """Priors of 1 km hold nothing: taking the estimated offsets off the data changes no pose."""
    made = make_synthetic_setup(0, MIXED, SyntheticWorld(range_bias_m=0.014 * SIGNS))
    loose = [h for h in list_testable_corrections(made) if h.name == "beam_offsets"]
    made = replace(
        made, corrections=tuple(replace(h, prior_sigma=1e3 * h.prior_sigma) for h in loose)
    )
    result = estimate_poses(
        made,
        START,
        max_rounds=40,
        tolerance_m=1e-10,
        tolerance_rad=1e-10,
        initial_noise_factor=100.0,
    )
    lidar = lidar_of(made, result)
    groups = [mended(g, lidar) if g.kind == "target_surface" else g for g in made.groups]
    again = replace(made, groups=groups, corrections=())
    state = replace(result.state, correction_values=np.zeros(0))
    problem = build_nlp(again)
    _, fit, twists = solve_round(again, problem, state, assign_measurements(again, state))
    assert fit.has_converged and np.abs(twists).max() < 1e-9


def mended(group, lidar):
    """The group with the lidar's offsets taken off its returns."""
    k = group.keypoints
    return replace(group, keypoints=k | {"xyz": lidar.correct_ranges(k)})


def estimable_corrections(made):
    """The corrections of sensor models that a Setup would estimate, if their errors were found."""
    wider = [h.add_to_setup(made) for h in list_testable_corrections(made)]
    return tuple(w.corrections[-1] for w in wider if w is not None and w.corrections)


def test_slopes_by_the_numbers_are_those_of_the_residuals():
    """Over a step of 1 % of their σ, for every correction that can be estimated."""
    made = make_synthetic_setup(0, MIXED[5:9])
    found = estimable_corrections(made)
    assert {h.name for h in found} == {
        "beam_offsets",
        "range_bias",
        "dark_ranges",
        "beam_width",
        "outline_vs_surface",
        "distortion",
        "board_shape",
        "mocap_scale",
    }
    made = replace(made, corrections=found)
    state = initial_state(made, synthetic_setup.TRUE_POSES, 1.0)
    assigned = assign_measurements(made, state)
    slopes = correction_derivatives(made, state, assigned)
    for i, sigma in enumerate(made.correction_sigma):
        theta = np.zeros_like(made.correction_sigma)
        theta[i] = 0.01 * sigma
        moved = assign_measurements(made, replace(state, correction_values=theta))
        for g, before, after, slope in zip(made.groups, assigned, moved, slopes, strict=True):
            member = (before.feature >= 0) & (after.feature == before.feature)
            rise = (after.standardized - before.standardized).T[:, member] / 0.01
            at = np.flatnonzero(made.correction_index(g) == i)
            expected = slope[at[0]][:, member] if len(at) else np.zeros_like(rise)
            np.testing.assert_allclose(rise, expected, atol=0.03 * max(np.abs(expected).max(), 1.0))


def test_residuals_of_the_kernels_are_those_of_the_assignment_with_everything_estimated():
    made = make_synthetic_setup(0, MIXED[5:9])
    made = replace(made, corrections=estimable_corrections(made))
    state = initial_state(made, synthetic_setup.TRUE_POSES, 1.0)
    state = replace(state, correction_values=0.3 * made.correction_sigma)
    assigned = assign_measurements(made, state)
    nlp = build_nlp(made)
    nlp.set_models(cameras_at_estimate(made, state), targets_at_estimate(made, state))
    parts = linearize_measurements(made, nlp, state, assigned)
    for a, part in zip(assigned, parts, strict=True):
        member = a.feature >= 0
        np.testing.assert_allclose(
            part.residuals[:, member], a.standardized.T[:, member], atol=1e-6
        )


# --- two places for one lidar


def torn(yaw, seed=0):
    """A Setup in which outlines see the lidar turned about its z by an angle, rad."""
    made = make_synthetic_setup(seed, MIXED)
    back = so3_exp([0.0, 0.0, -yaw])

    def turned(group):
        return replace(group, keypoints=group.keypoints | {"xyz": group.keypoints["xyz"] @ back.T})

    return replace(
        made, groups=[turned(g) if g.kind == "board_outline" else g for g in made.groups]
    )


def test_where_returns_and_outlines_disagree_the_returns_are_believed():
    """By 10 mrad of yaw, of which the lidar's own is found to 3 of its σ."""
    made, result, _ = estimate_with_corrections(torn(0.01), START, AUTO, **LIMITS)
    assert [h.name for h in made.corrections] == ["outline_vs_surface"]
    (told,) = sensor_corrections_json(made, result, "lidar")
    assert told["estimate"][5] == pytest.approx(0.01, abs=3 * told["sigma"][5])
    assert "put it elsewhere than its returns do" in told["description"]
    off = error(result, "lidar")
    assert off @ np.linalg.solve(spread(result, made, "lidar"), off) < 16.8  # 99 % of six
    assert np.abs(off[5]) < 0.003


def test_a_disagreement_costs_the_outlines_their_say_and_shows_in_the_sigma():
    """σ as good as without outlines at all: within 15 % of it, per axis."""
    made, result, _ = estimate_with_corrections(torn(0.01), START, AUTO, **LIMITS)
    bare = replace(
        made, groups=[g for g in made.groups if g.kind != "board_outline"], corrections=()
    )
    returns = estimate_poses(bare, START, **LIMITS)
    ratio = np.diag(spread(result, made, "lidar")) / np.diag(spread(returns, bare, "lidar"))
    assert (np.sqrt(ratio) > 0.85).all() and (np.sqrt(ratio) < 1.02).all()


# --- a lidar's model


def test_ranges_are_mended_by_the_bias_of_all_and_the_offset_of_their_ring():
    lidar = LidarModel(
        0.003, 0.03, None, None, (0.3, 100), 0.01, range_bias=0.1, range_offsets=(0.0, -0.3)
    )
    xyz = np.array([[2.0, 0, 0], [0, 2.0, 0], [0, 0, 2.0], [2.0, 0, 0]])
    mended = np.linalg.norm(
        lidar.correct_ranges({"xyz": xyz, "feature_index": np.array([0, 1, 2, -1])}), axis=1
    )
    np.testing.assert_allclose(mended, [1.9, 2.2, 1.9, 1.9])


def test_an_outline_is_wider_by_the_lens_over_the_range_and_by_the_divergence():
    lidar = replace(LIDAR_MODEL, beam_width=(0.01, 0.002))
    np.testing.assert_allclose(lidar.outline_dilation(np.array([1.0, 5.0])), [0.012, 0.004])


def test_rays_turn_with_the_displacement_of_outlines_and_returns_do_not():
    lidar = replace(LIDAR_MODEL, outline_twist=(0.0, 0.2, 0.0, 0.0, 0.0, 0.0))
    xyz = np.array([[2.0, 0.0, 0.0]])
    np.testing.assert_array_equal(
        lidar.correct_ranges({"xyz": xyz, "feature_index": np.zeros(1, int)}), xyz
    )
    ray = lidar.correct_rays(np.array([[1.0, 0.0, 0.0]]), np.array([2.0]))
    np.testing.assert_allclose(ray * 2 / ray[0, 0], [[2.0, 0.2, 0.0]])
