"""Placements left out, σ against their number, and directions that are open, on made Setups."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.leave_one_out import leave_one_out, sigma_by_placements_json
from calib.diagnosis.observability import (
    advise_views,
    describe_pose_direction,
    largest_angle_deg,
    shared_direction,
)
from calib.diagnosis.residual_statistics import leave_one_out_statistics, rejected_by_region
from calib.diagnosis.solution_json import marginal_joint_covariance, relative_poses_json
from calib.estimation.measurement_assignment import assign_measurements
from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.estimation.nlp.measurement_factor import joint_information
from calib.estimation.round_solution import build_nlp, solve_round
from calib.geometry.se3 import invert_pose, make_pose, pose_from_rpy, se3_exp, se3_log
from helpers.synthetic_setup import make_synthetic_setup, solve_synthetic_setup

MIXED = [("board", None)] * 7 + [("cylinder", None)] * 3
PARALLEL = [("cylinder", [0, 0, 1])]


@pytest.fixture(scope="module")
def made():
    clean = make_synthetic_setup(0, MIXED)
    return clean, solve_synthetic_setup(clean)


def without(setup, k):
    """The Setup with the groups of one placement taken off."""
    return replace(setup, groups=[g for g in setup.groups if g.placement != k])


def solved_at(setup, state):
    """The State that solving ends in with the noise as it is."""
    programme = build_nlp(setup)
    for _ in range(6):
        state, _, _ = solve_round(setup, programme, state, assign_measurements(setup, state))
    return state


def test_leaving_a_placement_out_moves_poses_as_solving_without_it_does(made):
    """First order against a full solution with the same noise: to 0.1 σ."""
    clean, result = made
    P = covariance_from_information(result.solve_result.information)
    all_left = {lf.placement: lf for lf in leave_one_out(clean, result)}
    for k in (0, 8):
        rest = solved_at(without(clean, k), result.state)
        for i, name in enumerate(sorted(clean.models)):
            T = result.state.T_robot_sensor[name], rest.T_robot_sensor[name]
            xi = se3_log(invert_pose(T[0]) @ T[1])
            block = P[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
            moved = np.sqrt(xi @ np.linalg.solve(block, xi))
            assert all_left[k].influence_by_sensor[name] == pytest.approx(moved, abs=0.1)


def test_held_out_errors_of_clean_logs_are_as_large_as_predicted():
    ratios = []
    for seed in range(2):
        clean = make_synthetic_setup(seed, MIXED)
        left = leave_one_out(clean, solve_synthetic_setup(clean))
        ratios += [
            leave_one_out_statistics(n, left)["error_over_sigma"] for n in sorted(clean.models)
        ]
    # 7 × 6 directions of the camera, more of the lidar: one ratio scatters by 0.1;
    # over 40 logs the mean is 0.89, for σ is a little too large rather than too small.
    assert np.mean(ratios) == pytest.approx(0.9, abs=0.15)
    assert max(ratios) < 1.5


def test_a_placement_that_was_not_still_is_the_most_influential_and_unlike_the_others(made):
    clean = make_synthetic_setup(0, MIXED)
    place = clean.placements[3]
    moved = place.T_robot_body @ make_pose(None, [0.0, 0.004, 0.0])
    places = [replace(p, T_robot_body=moved) if p is place else p for p in clean.placements]
    wrong = replace(clean, placements=places)
    left = leave_one_out(wrong, solve_synthetic_setup(wrong))
    held = {
        lf.placement: lf.error_by_sensor["camera"].nees
        for lf in left
        if "camera" in lf.error_by_sensor
    }
    assert max(held, key=held.get) == 3
    assert max(left, key=lambda lf: lf.influence_by_sensor["camera"]).placement == 3


def test_without_a_placement_that_it_needs_a_pose_is_lost():
    needed = make_synthetic_setup(
        0, [("cylinder", [0, 0, 1]), ("cylinder", [0, 0, 1]), ("cylinder", [0, 1, 0])]
    )
    left = leave_one_out(needed, solve_synthetic_setup(needed))
    assert [np.isinf(lf.influence_by_sensor["lidar"]) for lf in left][2]


def test_sigma_falls_with_the_number_of_placements_to_that_of_the_result(made):
    clean, result = made
    P = covariance_from_information(result.solve_result.information)
    for i, name in enumerate(sorted(clean.models)):
        told = sigma_by_placements_json(clean, result, name)
        sigma = np.sqrt(np.diag(P)[6 * i : 6 * i + 3].max())
        assert told["placements"][0] == 3
        assert told["sigma_m"][-1] == pytest.approx(sigma, rel=0.02)
        assert (np.diff(told["sigma_m"]) < 0).all()
        # Like the root of the number, at first faster.
        assert told["sigma_m"][0] > np.sqrt(told["placements"][-1] / 3) * sigma * 0.9


def test_the_predicted_sigma_is_that_of_a_log_with_so_few_placements(made):
    clean, result = made
    told = sigma_by_placements_json(clean, result, "camera")
    four = told["sigma_m"][told["placements"].index(4)]
    sigmas = []
    weight = (np.arange(clean.n_unknowns) >= clean.n_pose_unknowns).astype(float)
    for first in range(4):
        few = range(first, first + 4)
        both = zip(clean.groups, result.solve_result.factors, strict=True)
        P = covariance_from_information(
            joint_information([p for g, p in both if g.placement in few], weight)
        )
        sigmas.append(np.sqrt(np.diag(P)[:3].max()))
    assert min(sigmas) / 1.3 < four < max(sigmas) * 1.3


def test_too_few_placements_of_cylinders_have_no_predicted_sigma():
    parallel = make_synthetic_setup(0, PARALLEL * 9 + [("cylinder", [0, 1, 0])])
    told = sigma_by_placements_json(parallel, solve_synthetic_setup(parallel), "lidar")
    assert told["sigma_m"][0] is None and told["sigma_m"][-1] < 0.05


def test_the_pose_between_two_sensors_has_the_covariance_of_its_errors(made):
    """Of T_camera_lidar, for 4000 pairs of poses drawn from their joint covariance."""
    clean, result = made
    T, names = result.state.T_robot_sensor, ["camera", "lidar"]
    joint = marginal_joint_covariance(clean, result, names)
    (pair,) = relative_poses_json(T, names, joint)
    assert (pair["from"], pair["to"]) == ("camera", "lidar")
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(12), joint, 4000)
    a, b = (T[n] @ se3_exp(x) for n, x in zip(names, np.split(drawn, 2, 1), strict=True))
    apart = invert_pose(np.array(pair["T"]["matrix"])) @ invert_pose(a) @ b
    nees = np.linalg.inv(pair["covariance"]) @ np.cov(se3_log(apart).T)
    np.testing.assert_allclose(np.linalg.eigvals(nees).real, 1, atol=0.1)


def test_directions_are_named_by_the_axes_of_the_body_whatever_it_is():
    turned = pose_from_rpy([0, 0, 0], np.radians([0, 0, 90]))
    along_x = np.array([1.0, 0, 0, 0, 0, 0])
    assert describe_pose_direction(along_x, np.eye(4)) == "translation along x of the robot body"
    assert describe_pose_direction(along_x, turned) == "translation along y of the robot body"
    about = np.array([0, 0, 0, 0, 0.6, 0.8])
    words = describe_pose_direction(about, np.eye(4))
    assert words == "rotation about (0.00, 0.60, 0.80) of the robot body, mainly z"


def test_parallel_axes_are_named_and_a_tilt_is_advised():
    T = np.tile(np.eye(4), (5, 1, 1))
    seen = {"normals": np.zeros((0, 3)), "axes": T[:, :3, 0]}
    common = shared_direction(seen)
    words = describe_pose_direction(np.array([1.0, 0, 0, 0, 0, 0]), np.eye(4), common)
    assert words == "translation along the cylinders' common axis, x of the robot body"
    told = advise_views(seen, 5, is_lidar=True)
    assert "tilted by 30° or more" in told and "more views with the same tilt do not help" in told


def test_a_board_that_always_faces_one_way_is_to_be_turned_for_a_lidar():
    seen = {"normals": np.tile([0.0, 0, 1], (9, 1)), "axes": np.zeros((0, 3))}
    assert "turn the board by 20 to 40°" in advise_views(seen, 9, is_lidar=True)
    assert "3 different places" in advise_views(seen, 2, is_lidar=True)


def test_lines_have_no_sense_of_direction():
    assert largest_angle_deg(np.array([[1.0, 0, 0], [-1.0, 0, 0]])) == pytest.approx(0)
    assert largest_angle_deg(np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1]])) == 90
    assert largest_angle_deg(np.array([[1.0, 0, 0]])) is None


def test_what_is_left_out_is_counted_by_where_it_lies(made):
    clean = make_synthetic_setup(0, MIXED[6:8])
    for g in clean.groups:
        if g.kind == "target_surface":
            g.keypoints["xyz"][:10] *= 0.8  # a hand before the target
            g.keypoints["xyz"][10:15] *= 1.2
    result = solve_synthetic_setup(clean)
    found = rejected_by_region("lidar", clean, result)
    told = {r["region"]: r["count"] for r in found if r["target"] == "board"}
    assert told["before the surface"] == 10 and told["behind the surface"] == 5


def test_targets_that_rest_together_are_left_out_one_by_one():
    """They share the error of the robot's pose, which stays with the one that is left."""
    clean = make_synthetic_setup(0, MIXED[5:9])
    both = replace(
        clean, placements=[replace(p, robot_rest=i // 2) for i, p in enumerate(clean.placements)]
    )
    result = solve_synthetic_setup(both)
    assert both.n_unknowns == 12 + 6 * (2 + 4)
    left = leave_one_out(both, result)
    assert [sorted(lf.error_by_sensor) for lf in left] == [["camera", "lidar"]] * 2 + [
        ["lidar"]
    ] * 2


@pytest.mark.parametrize("seed", range(3))
def test_exact_ranges_beside_coarse_poses_leave_numbers_and_no_roots_of_rounding(seed):
    exact = make_synthetic_setup(
        seed, [("cylinder", None)] * 4, mcs_noise_factor=0.0, measurement_noise_factor=0.0
    )
    result = solve_synthetic_setup(exact)
    left = leave_one_out(exact, result)
    assert all(h.nees >= 0 for one in left for h in one.error_by_sensor.values())
    held = leave_one_out_statistics("lidar", left)
    assert held is None or np.isfinite(held["error_over_sigma"])
