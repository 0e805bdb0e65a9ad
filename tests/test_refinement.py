"""Numbers of the sensors beside their poses: taken in when the residuals ask for them, and true."""

from dataclasses import replace

import numpy as np
import pytest

import synthetic
from calib.diagnosis import consider_covariance, model_selection
from calib.estimation import estimate_state, pose_chain, solver
from calib.estimation.corrections import correction_catalog
from calib.estimation.nlp.information_matrix import covariance
from calib.geometry import se3
from calib.sensors.lidar import lidar_model
from synthetic import LIDAR, World, setup

MIXED = [("board", None)] * 7 + [("cylinder", None)] * 3
SIGNS = (-1.0) ** np.arange(synthetic.RINGS)
LIMITS = {"max_rounds": 30, "tolerance_m": 1e-6, "tolerance_rad": 1e-6, "noise": 100.0}
START = {n: T @ se3.se3_exp(np.full(6, 0.005)) for n, T in synthetic.TRUE.items()}
AUTO, OFF = {"beams": "auto"}, {"beams": False}


def refined(world, seed=0, wanted=AUTO):
    """(Setup, Result, suspicions) of measurements of a World."""
    return model_selection.estimate(setup(seed, MIXED, world), START, wanted, **LIMITS)


def error(result, name):
    """(6,) of a sensor's pose, m and rad."""
    return se3.se3_log(se3.inverse(synthetic.TRUE[name]) @ result.state.T_robot_sensor[name])


def spread(result, made, name):
    """(6, 6) covariance of a sensor's pose."""
    at = 6 * sorted(made.models).index(name)
    return covariance(result.solution.information)[at : at + 6, at : at + 6]


def lidar_of(made, result):
    """The lidar as its returns show it."""
    group = next(g for g in made.groups if g.kind == "surface")
    return pose_chain.model(made, result.state, group)


# --- what is taken in


@pytest.mark.parametrize("seed", range(3))
def test_of_a_lidar_without_fault_nothing_is_estimated_but_its_pose(seed):
    made, result, suspected = refined(World(), seed)
    assert made.corrections == () and suspected == []


def test_single_beams_off_by_14_mm_are_found_to_3_mm_and_suspected_no_more():
    made, result, suspected = refined(World(too_long=0.014 * SIGNS))
    assert [h.name for h in made.corrections] == ["beams"]
    offsets = lidar_of(made, result).range_offsets
    np.testing.assert_allclose(offsets, 0.014 * SIGNS, atol=0.003)
    assert suspected == [] and result.settled


def test_a_bias_of_all_ranges_is_found_to_2_sigma_of_its_own():
    made, result, _ = refined(World(too_long=np.full(synthetic.RINGS, 0.02)))
    (told,) = model_selection.corrections(made, result, "lidar")
    assert told["name"] == "range_bias" and "too long" in told["text"]
    assert abs(told["estimate"][0] - 0.02) < 2 * told["sigma"][0] < 0.002


def test_with_the_option_off_the_fault_is_named_and_not_estimated():
    made, _, suspected = refined(World(too_long=0.014 * SIGNS), wanted=OFF)
    assert made.corrections == ()
    assert [s["name"] for s in suspected] == ["beams"]


def test_estimated_beams_bring_back_the_noise_and_the_sigma_of_a_lidar_without_the_fault():
    """The pose with beams off by 14 mm, against that of the same draws without: within 1.2 σ."""
    _, clean, _ = refined(World())
    made, result, _ = refined(World(too_long=0.014 * SIGNS))
    noise = result.state.noise["lidar", "surface"].total
    assert noise == pytest.approx(clean.state.noise["lidar", "surface"].total, rel=0.1)
    sigma = np.sqrt(np.diag(spread(result, made, "lidar")))
    assert np.abs(error(result, "lidar") - error(clean, "lidar")).max() < 1.2 * sigma.max()


def test_what_is_estimated_besides_is_in_the_covariance_of_the_pose():
    """20 draws with both faults: NEES/6 of the lidar within its band of 99 %, [0.7, 1.35]."""
    world, nees = World(too_long=0.012 * SIGNS + 0.01), []
    for seed in range(20):
        made, result, _ = refined(world, seed)
        off = error(result, "lidar")
        nees.append(off @ np.linalg.solve(spread(result, made, "lidar"), off) / 6)
    assert 0.7 < np.mean(nees) < 1.35


def test_sigma_knows_what_beams_err_by_in_common_by_how_the_pose_would_follow():
    """Of a lidar whose beams err by 14 mm: its covariance grows by σ² k kᵀ, k being by how much the
    pose moves when all ranges are shortened by 0.2 mm and everything is estimated anew."""
    made = setup(0, MIXED, World(too_long=0.014 * SIGNS))
    (beams,) = [h for h in correction_catalog.all_of(made) if h.name == "beams"]
    made = replace(made, corrections=(beams,))
    result = solver.estimate(made, START, **LIMITS)
    longer = made.models | {"lidar": replace(LIDAR, range_bias=2e-4)}
    other = solver.estimate(replace(made, models=longer), START, **LIMITS)
    T, moved = (r.state.T_robot_sensor["lidar"] for r in (result, other))
    k = se3.se3_log(se3.inverse(T) @ moved) / 2e-4
    theta = result.state.theta
    sigma = np.sqrt(np.mean(theta**2) / (len(theta) + 1))
    grown = spread(consider_covariance.widened(made, result), made, "lidar") - spread(
        result, made, "lidar"
    )
    np.testing.assert_allclose(grown, sigma**2 * np.outer(k, k), atol=0.05 * grown.max())
    assert grown[:3, :3].trace() > 0.0005**2


# --- the programme with such numbers


def test_the_programme_finds_the_same_with_the_numbers_as_with_the_data_mended_by_hand():
    """Priors of 1 km hold nothing: taking the estimated offsets off the data changes no pose."""
    made = setup(0, MIXED, World(too_long=0.014 * SIGNS))
    loose = [h for h in correction_catalog.all_of(made) if h.name == "beams"]
    made = replace(made, corrections=tuple(replace(h, sigma=1e3 * h.sigma) for h in loose))
    result = solver.estimate(made, START, 40, 1e-10, 1e-10, 100.0)
    lidar = lidar_of(made, result)
    groups = [mended(g, lidar) if g.kind == "surface" else g for g in made.groups]
    again = replace(made, groups=groups, corrections=())
    state = replace(result.state, theta=np.zeros(0))
    problem = solver.build(again)
    _, fit, twists = solver.step(again, problem, state, solver.assign_all(again, state))
    assert fit.success and np.abs(twists).max() < 1e-9


def mended(group, lidar):
    """The group with the lidar's offsets taken off its returns."""
    k = group.keypoints
    return replace(group, keypoints=k | {"xyz": lidar.mended(k["xyz"], k["index"])})


def test_slopes_by_the_numbers_are_those_of_the_residuals():
    """Over a step of 1 % of their σ, for every Hypothesis that can be estimated."""
    made = setup(0, MIXED[5:9])
    found = tuple(h.instead or h for h in correction_catalog.all_of(made) if h.mended)
    assert {h.name for h in found} == {"beams", "range_bias", "beam_width", "apart"}
    made = replace(made, corrections=found)
    state = estimate_state.start(made, synthetic.TRUE, 1.0)
    assigned = solver.assign_all(made, state)
    slopes = solver.slopes(made, state, assigned)
    for i, sigma in enumerate(made.theta_sigma):
        theta = np.zeros_like(made.theta_sigma)
        theta[i] = 0.01 * sigma
        moved = solver.assign_all(made, replace(state, theta=theta))
        for g, before, after, slope in zip(made.groups, assigned, moved, slopes, strict=True):
            member = (before.feature >= 0) & (after.feature == before.feature)
            rise = (after.standard - before.standard).T[:, member] / 0.01
            at = np.flatnonzero(made.numbers(g) == i)
            expected = slope[at[0]][:, member] if len(at) else np.zeros_like(rise)
            np.testing.assert_allclose(rise, expected, atol=0.03 * max(np.abs(expected).max(), 1.0))


def test_residuals_of_the_kernels_are_those_of_the_assignment_with_everything_estimated():
    made = setup(0, MIXED[5:9])
    made = replace(
        made, corrections=tuple(h.instead or h for h in correction_catalog.all_of(made) if h.mended)
    )
    state = estimate_state.start(made, synthetic.TRUE, 1.0)
    state = replace(state, theta=0.3 * made.theta_sigma)
    assigned = solver.assign_all(made, state)
    given = *pose_chain.unknowns(made, state), pose_chain.chains(made, state), assigned
    slopes = solver.slopes(made, state, assigned)
    parts = solver.build(made).parts(*given, slopes, solver.errors(made, state))
    for a, part in zip(assigned, parts, strict=True):
        member = a.feature >= 0
        np.testing.assert_allclose(part.r[:, member], a.standard.T[:, member], atol=1e-6)


# --- two places for one lidar


def torn(yaw, seed=0):
    """A Setup in which outlines see the lidar turned about its z by an angle, rad."""
    made = setup(seed, MIXED)
    back = se3.so3_exp([0.0, 0.0, -yaw])

    def turned(group):
        return replace(group, keypoints=group.keypoints | {"xyz": group.keypoints["xyz"] @ back.T})

    return replace(made, groups=[turned(g) if g.kind == "edge" else g for g in made.groups])


def test_where_returns_and_outlines_disagree_the_returns_are_believed():
    """By 10 mrad of yaw, of which the lidar's own is found to 3 of its σ."""
    made, result, _ = model_selection.estimate(torn(0.01), START, AUTO, **LIMITS)
    assert [h.name for h in made.corrections] == ["apart"]
    (told,) = model_selection.corrections(made, result, "lidar")
    assert told["estimate"][5] == pytest.approx(0.01, abs=3 * told["sigma"][5])
    assert "put it elsewhere than its returns do" in told["text"]
    off = error(result, "lidar")
    assert off @ np.linalg.solve(spread(result, made, "lidar"), off) < 16.8  # 99 % of six
    assert np.abs(off[5]) < 0.003


def test_a_disagreement_costs_the_outlines_their_say_and_shows_in_the_sigma():
    """σ as good as without outlines at all: within 15 % of it, per axis."""
    made, result, _ = model_selection.estimate(torn(0.01), START, AUTO, **LIMITS)
    bare = replace(made, groups=[g for g in made.groups if g.kind != "edge"], corrections=())
    returns = solver.estimate(bare, START, **LIMITS)
    ratio = np.diag(spread(result, made, "lidar")) / np.diag(spread(returns, bare, "lidar"))
    assert (np.sqrt(ratio) > 0.85).all() and (np.sqrt(ratio) < 1.02).all()


# --- a lidar's model


def test_ranges_are_mended_by_the_bias_of_all_and_the_offset_of_their_ring():
    lidar = lidar_model.Lidar(
        0.003, 0.03, None, None, (0.3, 100), 0.01, range_bias=0.1, range_offsets=(0.0, -0.3)
    )
    xyz = np.array([[2.0, 0, 0], [0, 2.0, 0], [0, 0, 2.0], [2.0, 0, 0]])
    mended = np.linalg.norm(lidar.mended(xyz, np.array([0, 1, 2, -1])), axis=1)
    np.testing.assert_allclose(mended, [1.9, 2.2, 1.9, 1.9])


def test_an_outline_is_wider_by_the_lens_over_the_range_and_by_the_divergence():
    lidar = replace(LIDAR, beam_width=(0.01, 0.002))
    np.testing.assert_allclose(lidar.widening(np.array([1.0, 5.0])), [0.012, 0.004])


def test_rays_turn_with_the_displacement_of_outlines_and_returns_do_not():
    lidar = replace(LIDAR, apart=(0.0, 0.2, 0.0, 0.0, 0.0, 0.0))
    xyz = np.array([[2.0, 0.0, 0.0]])
    np.testing.assert_array_equal(lidar.mended(xyz, np.zeros(1, int)), xyz)
    ray = lidar.aimed(np.array([[1.0, 0.0, 0.0]]), np.array([2.0]))
    np.testing.assert_allclose(ray * 2 / ray[0, 0], [[2.0, 0.2, 0.0]])
