"""The joint estimate on measurements made by formula: exact recovery, covariance, bad geometry."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.observability import describe_pose_direction, find_undetermined_directions
from calib.diagnosis.residual_table import residual_columns
from calib.diagnosis.solution_json import noise_json, solution_json
from calib.estimation import pose_chain
from calib.estimation.estimate_state import initial_state
from calib.estimation.estimation_problem import MeasurementGroup, Placement, Setup
from calib.estimation.measurement_groups import assign_robot_rests
from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import (
    invert_pose,
    make_pose,
    pose_from_rpy,
    se3_exp,
    se3_log,
    so3_exp,
    transform_points,
)
from calib.io import status
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.board import Board
from calib.targets.cylinder import Cylinder
from calib.targets.patterns.checkerboard import Checkerboard

CAMERA = CameraModel(
    "radtan", (800.0, 800.0, 449.5, 349.5, -0.1, 0.02, 0.0005, -0.0003), (900, 700)
)
NO_OFFSET = {"time_offset_s": {"value": 0.0, "sigma": 0.05}}
LIDAR = LidarModel(np.radians(0.2), np.radians(2.0), None, None, (0.3, 100.0), 0.01)
BOARD = Board(
    np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]]),
    0.0,
    Checkerboard(6, 5, 0.08, (-0.2, -0.16)),
)
CYLINDER = Cylinder(0.8, 0.1)
TARGETS = {"board": BOARD, "cylinder": CYLINDER}
ASSOCIATE = {"gate_sigma": 6.0, "edge_margin_m": 0.02, "min_cosine": 0.3}
# Camera and lidar look along the robot's x.
FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
TRUE = {
    "camera": make_pose(FORWARD, [0.2, 0.1, 0.5]),
    "lidar": pose_from_rpy([0.1, -0.05, 0.7], [0.02, -0.03, 0.05]),
}
MCS_SIGMA = np.repeat([1e-4, np.radians(0.01)], 3)


def T_robot_target(rng, name, axis=None):
    """A target 1.5 to 3 m before the robot, turned at random; a cylinder's axis may be given."""
    at = rng.uniform([1.5, -0.4, 0.3], [3.0, 0.4, 0.9])
    if name == "board":
        turn = so3_exp(rng.uniform(-0.6, 0.6, 3))
        return make_pose(turn @ np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]]), at)
    x = rng.normal(size=3) if axis is None else np.asarray(axis, float)
    x /= np.linalg.norm(x)
    y = np.cross(x, [0.3, 0.5, 0.8])
    y /= np.linalg.norm(y)
    return make_pose(np.column_stack([x, y, np.cross(x, y)]), at)


def columns(kind, placement, xyz=None, uv=None, sigma=1.0):
    n = len(xyz if uv is None else uv)
    return {
        "view": np.full(n, placement),
        "stamp_ns": np.zeros(n, int),
        "target": np.full(n, ""),
        "placement": np.full(n, placement),
        "kind": np.full(n, kind),
        "feature_index": np.arange(n) if kind == "pattern_corner" else np.zeros(n, int),
        "xyz": np.full((n, 3), np.nan) if xyz is None else xyz,
        "uv": np.full((n, 2), np.nan) if uv is None else uv,
        "sigma": np.full(n, sigma),
        "whitening": np.tile([1.0, 0.0, 1.0], (n, 1)),
        "intensity": np.full(n, np.nan),
    }


def corners(rng, T, placement, noise):
    uv, valid = CAMERA.project(transform_points(T, BOARD.pattern.corners()))
    assert valid.all()
    return columns(
        "pattern_corner", placement, uv=uv + noise * rng.normal(size=uv.shape), sigma=0.05
    )


def returns(rng, name, T, placement, noise, n=150):
    """Points on the side of a target that faces the lidar, with noise along the beam."""
    if name == "board":
        q = np.column_stack([rng.uniform(-0.45, 0.45, (n, 2)), np.zeros(n)])
    else:
        sensor = invert_pose(T)[:3, 3]
        around = np.arctan2(sensor[2], sensor[1]) + rng.uniform(-1.0, 1.0, n)
        q = np.column_stack(
            [rng.uniform(-0.37, 0.37, n), 0.1 * np.cos(around), 0.1 * np.sin(around)]
        )
    p = transform_points(T, q)
    ranges = np.linalg.norm(p, axis=1, keepdims=True)
    return columns(
        "target_surface",
        placement,
        xyz=p * (1 + noise * rng.normal(size=(n, 1)) / ranges),
        sigma=0.01,
    )


def made(seed, layout, pixel=0.0, range_=0.0, mcs=0.0):
    """A Setup of placements [(target, axis)], with noise of the given σ (mcs: times MCS_SIGMA)."""
    rng = np.random.default_rng(seed)
    geometry_rng = np.random.default_rng(99)
    places, groups = [], []
    for k, (name, axis) in enumerate(layout):
        T = T_robot_target(geometry_rng, name, axis)
        error = mcs * MCS_SIGMA * rng.normal(size=(2, 6))
        robot, body = se3_exp(error)
        # What the MCS says: both true poses with their errors taken off.
        said = robot @ T @ invert_pose(body)
        places.append(Placement("s", name, said, np.eye(4), MCS_SIGMA))
        sensors = ["lidar", "camera"] if name == "board" else ["lidar"]
        for sensor in sensors:
            T_sensor = invert_pose(TRUE[sensor]) @ T
            if sensor == "camera":
                groups.append(
                    MeasurementGroup(
                        "camera", k, "pattern_corner", corners(rng, T_sensor, k, pixel)
                    )
                )
            else:
                found = returns(rng, name, T_sensor, k, range_)
                groups.append(MeasurementGroup("lidar", k, "target_surface", found))
    models = {"camera": CAMERA, "lidar": LIDAR}
    models = {n: m for n, m in models.items() if any(g.sensor == n for g in groups)}
    return Setup(models, TARGETS, places, groups, ASSOCIATE, {})


def settled(setup, off=0.01):
    """The Result from a start that is off by about 1 cm and 0.6°."""
    start = {n: TRUE[n] @ se3_exp(np.full(6, off)) for n in setup.models}
    result = estimate_poses(
        setup,
        start,
        max_rounds=40,
        tolerance_m=1e-8,
        tolerance_rad=1e-8,
        initial_noise_factor=500.0,
    )
    assert result.has_converged
    return result


def error(result, name):
    return se3_log(invert_pose(TRUE[name]) @ result.state.T_robot_sensor[name])


MIXED = [("board", None), ("cylinder", None)] * 4


def test_exact_measurements_give_the_exact_poses():
    result = settled(made(0, MIXED))
    for name in ("camera", "lidar"):
        assert np.abs(error(result, name)).max() < 1e-7


def test_the_result_does_not_depend_on_where_it_starts():
    setup = made(0, MIXED, pixel=0.05, range_=0.01, mcs=1.0)
    a, b = (settled(setup, off) for off in (0.01, -0.008))
    for name in setup.models:
        apart = invert_pose(a.state.T_robot_sensor[name]) @ b.state.T_robot_sensor[name]
        assert np.abs(se3_log(apart)).max() < 1e-6


@pytest.mark.slow
def test_the_covariance_is_that_of_the_errors_over_30_noise_draws():
    """The mean of eᵀΣ⁻¹e over both sensors is chi-square distributed with 12 degrees of freedom.

    Correlations and the order of the twist count: a permuted covariance fails.
    """
    draws, nees, permuted = 30, [], []
    for seed in range(draws):
        result = settled(made(seed, MIXED, pixel=0.05, range_=0.01, mcs=1.0))
        spread = covariance_from_information(result.solve_result.information)[:12, :12]
        e = np.concatenate([error(result, n) for n in ("camera", "lidar")])
        nees.append(e @ np.linalg.solve(spread, e))
        swap = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
        permuted.append(e @ np.linalg.solve(spread[np.ix_(swap, swap)], e))
    # Mean 12, standard deviation of the mean sqrt(24 / 30) = 0.9: a band of 3 of them; the
    # information under the robust loss is up to 6 % too small.
    assert 12 / 1.06 - 2.7 < np.mean(nees) < 12 + 2.7
    assert np.mean(permuted) > 20


def test_the_noise_of_each_sensor_is_found_whatever_was_configured():
    result = settled(made(1, MIXED, pixel=0.2, range_=0.003, mcs=1.0))
    noise = noise_json(made(1, MIXED), result)["sensors"]
    assert noise["camera"]["pattern_corner"] == pytest.approx(0.2, rel=0.1)
    assert noise["lidar"]["target_surface"] == pytest.approx(0.003, rel=0.1)


def test_the_covariance_is_positive_with_exact_ranges_beside_coarse_mcs_poses():
    """Ranges to a micrometre beside pose priors of 0.1 mm strain double precision."""
    result = settled(made(1, MIXED, range_=0.0, pixel=0.0, mcs=1.0))
    spread = covariance_from_information(result.solve_result.information)[:12, :12]
    sigma = np.sqrt(np.linalg.eigvalsh(spread))
    assert (sigma > 1e-6).all() and (sigma < 1e-3).all()


def test_mcs_noise_beyond_its_prior_is_found():
    result = settled(made(1, MIXED * 2, pixel=0.05, range_=0.001, mcs=5.0))
    assert 3 < result.state.mocap_noise_factor < 7


def test_one_outlier_in_twenty_moves_the_result_by_less_than_half_a_sigma():
    clean = made(2, MIXED, pixel=0.05, range_=0.01, mcs=1.0)
    dirty = made(2, MIXED, pixel=0.05, range_=0.01, mcs=1.0)
    for g in dirty.groups:
        if g.kind == "target_surface":
            g.keypoints["xyz"][::20] *= 1.05
    a, b = settled(clean), settled(dirty)
    spread = covariance_from_information(a.solve_result.information)[:12, :12]
    apart = invert_pose(a.state.T_robot_sensor["lidar"]) @ b.state.T_robot_sensor["lidar"]
    assert (np.abs(se3_log(apart)) < 0.5 * np.sqrt(np.diag(spread)[6:])).all()


@pytest.mark.parametrize("count", [5, 20])
def test_cylinders_with_parallel_axes_leave_two_directions_open_however_many_there_are(count):
    setup = made(3, [("cylinder", [0, 0, 1])] * count, range_=0.01)
    result = estimate_poses(
        setup,
        {"lidar": TRUE["lidar"]},
        max_rounds=30,
        tolerance_m=1e-8,
        tolerance_rad=1e-8,
        initial_noise_factor=10.0,
    )
    found = find_undetermined_directions(result.solve_result.information, 1, 0)
    words = [describe_pose_direction(d, TRUE["lidar"]) for d in found]
    assert any("translation along z of the robot body" in w for w in words)


def test_five_diverse_cylinders_determine_the_lidar():
    setup = made(3, [("cylinder", None)] * 5, range_=0.01)
    result = settled(setup)
    assert len(find_undetermined_directions(result.solve_result.information, 1, 0)) == 0


def test_one_board_seen_by_a_lidar_leaves_three_directions_open():
    result = estimate_poses(
        made(4, [("board", None)]),
        {"lidar": TRUE["lidar"], "camera": TRUE["camera"]},
        max_rounds=5,
        tolerance_m=1,
        tolerance_rad=1,
        initial_noise_factor=1.0,
    )
    names = sorted(["camera", "lidar"])
    found = find_undetermined_directions(result.solve_result.information, 2, names.index("lidar"))
    assert len(found) == 3


def test_a_sensor_with_an_open_direction_gets_no_pose_and_says_which():
    setup = made(3, [("cylinder", [0, 0, 1])] * 5, range_=0.01)
    result = estimate_poses(
        setup,
        {"lidar": TRUE["lidar"]},
        max_rounds=30,
        tolerance_m=1e-8,
        tolerance_rad=1e-8,
        initial_noise_factor=10.0,
    )
    guess = {
        "frame": "lidar",
        "T_robot_sensor": None,
        "sigma": [1] * 6,
        "source": "config",
    } | NO_OFFSET
    options = {
        "rig": "r",
        "sensors": {"lidar": {"kind": "lidar"}},
        "targets": {"cylinder": {}},
        "sessions": ["s"],
    }
    content = solution_json(setup, result, [], {"lidar": (status.OK, guess)}, options)
    lidar = content["sensors"]["lidar"]
    assert lidar["T_robot_sensor"] is None and lidar["covariance"] is None
    assert "cylinders' common axis, z of the robot body" in lidar["status"]["reason"]
    assert content["joint_covariance"] is None


def test_the_results_carry_the_covariance_of_the_estimate_in_its_own_order():
    """(tx ty tz rx ry rz) per sensor; the draws above show that this order is the errors'."""
    setup = made(5, MIXED, pixel=0.05, range_=0.01, mcs=1.0)
    result = settled(setup)
    guess = {"frame": "f", "T_robot_sensor": None, "sigma": [1] * 6, "source": "config"} | NO_OFFSET
    kinds = {"camera": {"kind": "camera"}, "lidar": {"kind": "lidar"}}
    options = {"rig": "r", "sensors": kinds, "targets": {}, "sessions": ["s"]}
    known = {name: (status.OK, guess) for name in kinds}
    content = solution_json(setup, result, [], known, options)
    spread = covariance_from_information(result.solve_result.information)
    assert content["joint_covariance"]["order"] == ["camera", "lidar"]
    np.testing.assert_array_equal(content["joint_covariance"]["matrix"], spread[:12, :12])
    for name, at in (("camera", 0), ("lidar", 6)):
        own = spread[at : at + 6, at : at + 6]
        np.testing.assert_array_equal(content["sensors"][name]["covariance"], own)


def test_nothing_to_solve_is_a_result_without_a_solution():
    setup = Setup({}, TARGETS, [], [], ASSOCIATE, {})
    result = estimate_poses(
        setup, {}, max_rounds=30, tolerance_m=1e-8, tolerance_rad=1e-8, initial_noise_factor=10.0
    )
    assert result.solve_result is None and not result.has_converged
    assert len(residual_columns(setup, result)["sensor"]) == 0


def test_a_prior_holds_what_the_data_leave_open():
    setup = made(3, [("cylinder", [0, 0, 1])] * 5, range_=0.01)
    sigma = np.full(6, 0.01)
    held = Setup(**vars(setup) | {"sensor_priors": {"lidar": (TRUE["lidar"], sigma)}})
    result = estimate_poses(
        held,
        {"lidar": TRUE["lidar"]},
        max_rounds=30,
        tolerance_m=1e-8,
        tolerance_rad=1e-8,
        initial_noise_factor=10.0,
    )
    assert np.abs(error(result, "lidar")).max() < 0.01


# --- mounts that are not known, and rests that several targets share


def test_where_a_board_sits_in_its_body_is_found_with_the_sensors_from_exact_measurements():
    setup = replace(made(0, MIXED), initial_mounts={"board": se3_exp(np.full(6, 0.02))})
    result = settled(setup)
    assert np.abs(se3_log(result.state.mounts["board"])).max() < 1e-7
    for name in ("camera", "lidar"):
        assert np.abs(error(result, name)).max() < 1e-7


def test_a_mount_that_is_estimated_leaves_the_sensors_less_certain():
    setup = made(0, MIXED, pixel=0.05, range_=0.01, mcs=1.0)
    free = replace(setup, initial_mounts={"board": np.eye(4)})
    sigmas = [
        np.sqrt(np.diag(covariance_from_information(settled(s).solve_result.information))[:6])
        for s in (setup, free)
    ]
    assert (sigmas[1] > sigmas[0]).all()


def test_targets_at_one_rest_of_the_robot_share_the_error_of_its_pose():
    setup = made(0, MIXED, pixel=0.05, range_=0.01, mcs=1.0)
    places = [replace(p, robot_rest=i // 2) for i, p in enumerate(setup.placements)]
    shared = replace(setup, placements=places)
    assert shared.robot_error_index.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    assert (shared.n_unknowns, setup.n_unknowns) == (12 + 6 * (4 + 8), 12 + 6 * 16)
    T = [pose_chain.T_robot_target(shared, initial_state(shared, TRUE, 1.0), k) for k in (0, 1)]
    state = initial_state(shared, TRUE, 1.0)
    state.mocap_errors[0, 0] = 3.0
    moved = [pose_chain.T_robot_target(shared, state, k) for k in (0, 1)]
    for k in (0, 1):
        step = moved[k][:3, 3] - T[k][:3, 3]
        assert step == pytest.approx([-3 * MCS_SIGMA[0], 0, 0], abs=1e-12)


def test_rests_of_two_sessions_are_never_the_same():
    setup = made(0, MIXED)
    places = [replace(p, robot_rest=0, session="ab"[i % 2]) for i, p in enumerate(setup.placements)]
    assert replace(setup, placements=places).robot_error_index.tolist() == [0, 1] * 4


def test_still_intervals_that_overlap_by_more_than_half_are_one_rest():
    start, end = np.array([[0, 10], [1, 11], [9, 20], [30, 40], [32, 50], [12, 19]]).T
    kind = np.array(["still", "still", "still", "still", "still", "moving"])
    found = assign_robot_rests({"start_ns": start, "end_ns": end, "kind": kind})
    assert found[0] == found[1] != found[2] and found[3] == found[4] != found[2] and found[5] == -1
