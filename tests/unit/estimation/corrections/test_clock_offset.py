"""Clocks: poses between the samples of the MCS, and a sensor's offset from targets in motion."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.correction_selection import estimate_with_corrections
from calib.estimation.corrections.clock_drift import clock_drift_json
from calib.estimation.corrections.clock_offset import (
    TimeOffsetCorrection,
    stream_lags_json,
    time_offset_json,
)
from calib.estimation.estimate_state import initial_state
from calib.estimation.estimation_problem import MeasurementGroup, Placement
from calib.estimation.measurement_assignment import assign_measurements
from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.estimation.round_solution import build_nlp, linearize_measurements
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import invert_pose, se3_exp, se3_log, transform_points
from calib.geometry.units import NS_PER_S
from calib.io.config import load_schema
from calib.mocap.body_trajectory import Trajectory, find_separate_streams, relative_trajectory
from calib.mocap.moving_pose_fit import MovingView, fit_local_motion
from helpers import synthetic_setup
from helpers.synthetic_setup import (
    BOARD_TARGET,
    CAMERA_MODEL,
    PIXEL_SIGMA_PX,
    RANGE_SIGMA_M,
    TRUE_POSES,
    make_synthetic_setup,
)

RATE = 100  # Hz of the MCS
START = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in TRUE_POSES.items()}
STILL = [("board", None)] * 8
NONE = np.zeros((2, 6))
SUSPECTED_ERROR_KEYS = set(
    load_schema("calibration")["properties"]["suspected_errors"]["items"]["required"]
)
FACTOR = 0.55  # σ of a pose between the samples over that of one of them


def swinging(seed, k, centre, seconds=1.0):
    """Function t (n,), s -> T_robot_board (n, 4, 4): about a pose, some 0.3 m/s and 20°/s."""
    rng = np.random.default_rng([seed, k])
    size = np.repeat([0.1, 0.12], 3) * rng.uniform(0.5, 1, 6)
    rate, phase = rng.uniform(2, 4, 6), rng.uniform(0, 2 * np.pi, 6)
    return lambda t: centre @ se3_exp(size * np.sin(rate * np.asarray(t)[..., None] + phase))


def trajectory(path, rng=None, noise=0.0, late=0.0, bias=NONE):
    """Samples of a path over ±0.5 s, with the noise of both bodies' poses and what they are off by
    in common (2, 6), stamps late by s."""
    t = np.arange(-RATE // 2, RATE // 2 + 1) / RATE
    T = path(t)
    if rng is not None:
        errors = noise * synthetic_setup.MCS_SIGMA * rng.normal(size=(2, len(t), 6))
        errors += np.reshape(bias, (2, 1, 6))
        T = se3_exp(errors[0]) @ T @ se3_exp(errors[1])
    return Trajectory(np.round((t + late) * NS_PER_S).astype(np.int64), T, round(0.05 * NS_PER_S))


# --- between the samples


@pytest.mark.parametrize("t", [-0.2004, 0.0, 0.013, 0.3333])
def test_pose_and_velocity_between_samples_are_those_of_the_path_to_10_micrometres(t):
    path = swinging(0, 0, TRUE_POSES["lidar"])
    found = fit_local_motion(trajectory(path), round(t * NS_PER_S))
    off = se3_log(invert_pose(path(t)) @ found.T_robot_body)
    h = 1e-5
    velocity = se3_log(invert_pose(path(t - h)) @ path(t + h)) / (2 * h)
    assert np.abs(off).max() < 1e-5
    assert np.abs(found.velocity - velocity).max() < 2e-3 * np.abs(velocity).max()


def test_the_pose_is_smooth_in_time_where_samples_come_and_go():
    fits = [
        fit_local_motion(trajectory(swinging(0, 1, np.eye(4))), t)
        for t in range(0, 20_000_000, 100_000)
    ]
    steps = se3_log(
        np.array(
            [
                invert_pose(a.T_robot_body) @ b.T_robot_body
                for a, b in zip(fits, fits[1:], strict=False)
            ]
        )
    )
    assert (
        np.linalg.norm(np.diff(steps, axis=0), axis=1).max()
        < 0.02 * np.linalg.norm(steps, axis=1).max()
    )


def test_the_factor_is_the_noise_of_the_pose_over_that_of_a_sample():
    rng, still = np.random.default_rng(0), lambda t: np.tile(np.eye(4), (len(t), 1, 1))
    found = [fit_local_motion(trajectory(still, rng, 1.0), 2_000_000) for _ in range(400)]
    errors = (
        se3_log(np.array([f.T_robot_body for f in found])) / synthetic_setup.MCS_SIGMA / np.sqrt(2)
    )
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(found[0].sigma_factor, rel=0.05)
    assert found[0].sigma_factor == pytest.approx(FACTOR, rel=0.03)


@pytest.mark.parametrize("gone", [slice(30, 40), slice(0, 52), slice(47, None)])
def test_near_a_gap_or_an_end_nothing_is_told(gone):
    full = trajectory(swinging(0, 0, np.eye(4)))
    keep = np.ones(len(full.stamps_ns), bool)
    keep[gone] = False
    cut = Trajectory(full.stamps_ns[keep], full.poses[keep], full.max_gap_ns)
    at = {30: -0.15, 0: -0.01, 47: -0.01}[gone.start]
    assert fit_local_motion(full, round(at * NS_PER_S)) is not None
    assert fit_local_motion(cut, round(at * NS_PER_S)) is None


# --- the offset


def moving(made, sensor, path, k, seed, late, session="s", begin=0.0, bias=NONE, n=40):
    """(Placement, Group) of a view of a board in motion; the MCS's stamps are late by s, and its
    poses of robot and board off by bias (2, 6)."""
    rng = np.random.default_rng([seed, k, 7])
    T_sensor_robot = invert_pose(TRUE_POSES[sensor])
    start = round(begin * NS_PER_S)
    place = Placement(
        session, "board", path(0.0), np.eye(4), synthetic_setup.MCS_SIGMA,
        moving_view=MovingView(
            sensor, start, trajectory(path, rng, 1.0, late + begin, bias),
            FACTOR * synthetic_setup.MCS_SIGMA,
        ),
    )  # fmt: skip
    if sensor == "camera":
        corners = BOARD_TARGET.pattern.corners()
        uv, _ = CAMERA_MODEL.project(transform_points(T_sensor_robot @ path(0.0), corners))
        uv = uv + PIXEL_SIGMA_PX * rng.normal(size=uv.shape)
        columns = synthetic_setup._keypoint_columns(
            "pattern_corner", k, np.arange(len(uv)), PIXEL_SIGMA_PX, uv
        )
        columns["stamp_ns"] = np.full(len(uv), start)
        return place, MeasurementGroup(sensor, k, "pattern_corner", columns, is_moving=True)
    q = np.column_stack([rng.uniform(-0.45, 0.45, (10 * n, 2)), np.zeros(10 * n)])
    t = rng.integers(-15_000_000, 15_000_000, len(q))
    p = np.array(
        [
            transform_points(T_sensor_robot @ path(s / NS_PER_S), x)
            for s, x in zip(t, q, strict=True)
        ]
    )
    p *= 1 + (RANGE_SIGMA_M * rng.normal(size=len(q)) / np.linalg.norm(p, axis=1))[:, None]
    columns = synthetic_setup._keypoint_columns(
        "target_surface", k, np.zeros(len(q), int), RANGE_SIGMA_M, xyz=p
    )
    return place, MeasurementGroup(
        sensor, k, "target_surface", columns | {"stamp_ns": t + start}, is_moving=True
    )


def recorded(late, seed=0, views=25, sensors=("camera", "lidar"), later=0.0, ppm=0.0):
    """A Setup of still placements and of views in motion, the MCS's stamps late by s, its poses in
    motion off by as much as those of a placement, alike in all views of a session.

    Views come every two seconds, by turns in two sessions: the stamps of the second are `later` by
    s, and in both they get later by so many millionths.
    """
    made = make_synthetic_setup(seed, STILL)
    places, groups = list(made.placements), list(made.groups)
    drawn = synthetic_setup.MCS_SIGMA * np.random.default_rng([seed, 3]).normal(size=(2, 2, 6))
    for sensor in sensors:
        for j in range(views):
            centre = made.placements[j % len(STILL)].T_robot_body
            begin, session = 2.0 * (j // 2), "su"[j % 2]
            off = late + (session == "u") * later + 1e-6 * ppm * (begin - (views - 1) // 2)
            seen = swinging(seed, j, centre), len(places), seed, off, session, begin, drawn[j % 2]
            place, group = moving(made, sensor, *seen)
            places.append(place)
            groups.append(group)
    clock = tuple(TimeOffsetCorrection(name, np.array([0.1])) for name in sensors)
    return replace(made, placements=places, groups=groups, corrections=clock)


def solved(made):
    return estimate_poses(
        made, START, max_rounds=40, tolerance_m=1e-7, tolerance_rad=1e-7, initial_noise_factor=30.0
    )


def offset(made, result, name):
    """(value, σ) of a sensor's offset, s."""
    at = [h.subject for h in made.corrections].index(name)
    sigma = np.sqrt(
        np.diag(covariance_from_information(result.solve_result.information))[
            made.n_chain_unknowns + at
        ]
    )
    return result.state.correction_values[at], sigma * made.correction_sigma[at]


@pytest.mark.parametrize("late", [0.0, 0.025, -0.04])
def test_an_offset_is_found_by_its_sigma_and_by_a_camera_to_half_a_millisecond(late):
    made = recorded(late)
    result = solved(made)
    assert result.has_converged
    for name in ("camera", "lidar"):
        value, sigma = offset(made, result, name)
        assert abs(value - late) < 3.5 * sigma, name
        assert sigma < {"camera": 3e-4, "lidar": 7e-4}[name]


@pytest.mark.slow
def test_of_many_draws_offsets_and_poses_err_by_their_sigma():
    """NEES of 24 draws within bands of 99.9 %: offsets [0.30, 2.15], poses [0.67, 1.42]."""
    nees = {"camera": [], "lidar": []}
    for seed in range(24):
        made = recorded(0.025, seed, views=12)
        result = solved(made)
        spread = covariance_from_information(result.solve_result.information)
        for i, name in enumerate(nees):
            value, sigma = offset(made, result, name)
            T = invert_pose(TRUE_POSES[name]) @ result.state.T_robot_sensor[name]
            off, at = se3_log(T), slice(6 * i, 6 * i + 6)
            pose = off @ np.linalg.solve(spread[at, at], off) / 6
            nees[name].append([((value - 0.025) / sigma) ** 2, pose])
    for name, found in nees.items():
        of_offset, of_pose = np.mean(found, 0)
        assert 0.30 < of_offset < 2.15, name
        assert 0.67 < of_pose < 1.42, name


LIMITS = {
    "max_rounds": 40,
    "tolerance_m": 1e-7,
    "tolerance_rad": 1e-7,
    "initial_noise_factor": 30.0,
}


def refined(made, wanted=None):
    """(Setup, Result, suspicions) with the views in motion added to the still placements, as solve
    does."""
    still = made.placements[: made.n_still]
    groups = [g for g in made.groups if not g.is_moving]
    bare = replace(made, placements=still, groups=groups, corrections=())
    moving = lambda setup: replace(made, initial_mounts=setup.initial_mounts)  # noqa: E731
    return estimate_with_corrections(bare, START, wanted or {}, moving, **LIMITS)


@pytest.mark.slow
def test_clocks_that_wander_are_found_with_drift_and_offset_of_every_session():
    made, result, _ = refined(recorded(0.02, views=40, later=0.004, ppm=300.0))
    assert result.has_converged
    seen = [a for g, a in zip(made.groups, result.assignments, strict=True) if g.is_moving]
    assert np.mean(np.concatenate([a.feature >= 0 for a in seen])) > 0.95
    guess = {"time_offset_s": {"value": 0.1, "sigma": 0.1}}
    for name in ("camera", "lidar"):
        found = clock_drift_json(name, made, result, guess)
        for session, late in (("s", 0.12), ("u", 0.124)):
            offset, drift = found[session]["time_offset_s"], found[session]["drift_ppm"]
            assert abs(offset["value"] - late) < 3.5 * offset["sigma"] < 3e-3, (name, session)
            assert abs(drift["value"] - 300) < 3.5 * drift["sigma"] < 250, (name, session)
        first = time_offset_json(name, made, result, guess)["time_offset_s"]
        assert first["value"] == pytest.approx(found["s"]["time_offset_s"]["value"], abs=1e-12)


@pytest.mark.slow
def test_a_target_whose_poses_come_late_by_a_stream_of_their_own_is_found_with_both_clocks():
    """The robot rolls and the board swings; its stamps are 12 ms early, those of sensors 20 ms."""
    made, lag = recorded(0.0, views=30), 0.012
    places = list(made.placements)
    for k in range(made.n_still, len(places)):
        place, rng = places[k], np.random.default_rng([k, 5])
        relative = place.moving_view.trajectory
        robot = swinging(1, k, np.eye(4))(
            (relative.stamps_ns - place.moving_view.stamp_ns) / NS_PER_S
        )
        clock = relative.stamps_ns + round(0.02 * NS_PER_S)
        noise = se3_exp(0.1 * synthetic_setup.MCS_SIGMA * rng.normal(size=(len(robot), 6)))
        body = Trajectory(
            clock - round(lag * NS_PER_S), robot @ relative.poses @ noise, relative.max_gap_ns
        )
        apart = Trajectory(clock, robot, relative.max_gap_ns), body
        moving = replace(
            place.moving_view, separate_trajectories=apart, trajectory=relative_trajectory(*apart)
        )
        places[k] = replace(place, moving_view=moving)
    made, result, _ = refined(replace(made, placements=places))
    assert result.has_converged
    found = stream_lags_json(made, result)["board"]
    assert abs(found["value"] - lag) < 3.5 * found["sigma"] < 2e-3
    for name in ("camera", "lidar"):
        value, sigma = offset(made, result, name)
        assert abs(value - 0.02) < 3.5 * sigma < 4e-3, name


def test_only_bodies_by_other_topics_than_the_robots_have_a_clock_of_their_own():
    poses = {k: np.zeros((0, n)) for k, n in (("xyz", 3), ("quat", 4))}
    poses |= {
        "stamp_ns": np.zeros(0, np.int64),
        "body": np.zeros(0, str),
        "fault": np.zeros(0, str),
    }
    topics = {"robot": ["/a"], "one": ["/b"], "two": ["/a", "/c"]}
    bodies = {"board": "one", "cylinder": "two", "plate": "unheard"}
    assert list(find_separate_streams(poses, "robot", bodies, topics, 0.05)) == ["board"]


@pytest.mark.slow
def test_clocks_that_keep_time_are_not_said_to_wander():
    """20 draws, each with two clocks: none is taken for one that wanders."""
    for seed in range(20):
        made = recorded(0.02, seed, views=12)
        setup, result, _ = refined(made)
        assert result.has_converged
        assert all(clock_drift_json(n, setup, result, None) is None for n in ("camera", "lidar"))


def test_a_clock_that_is_not_to_be_estimated_is_doubted_and_moves_no_pose():
    """25 ms off, and not off, beside the estimate without a view in motion."""
    bare = recorded(0.0, views=0)
    alone = solved(replace(bare, corrections=()))
    for late in (0.025, 0.0):
        made, result, suspected = refined(recorded(late), {"time_offset": False})
        assert not any(g.is_moving for g in made.groups) and made.corrections == ()
        clock = {s["subject"]: s for s in suspected if s["name"] == "time_offset"}
        assert sorted(clock) == ["camera", "lidar"]
        assert all(set(about) >= SUSPECTED_ERROR_KEYS for about in suspected)
        for name, about in clock.items():
            T = invert_pose(alone.state.T_robot_sensor[name]) @ result.state.T_robot_sensor[name]
            assert np.abs(se3_log(T)).max() < 1e-9
            assert abs(about["estimate"][0] - late) < 3.5 * about["sigma"][0] < 2.5e-3
            assert (about["p_value"] < 1e-5) == (late > 0)
    assert clock["camera"]["description"].startswith("the stamps of camera are ")


def test_views_added_to_a_settled_estimate_end_where_they_would_from_the_start():
    made = recorded(0.02, views=12)
    alone = solved(made)
    _, result, _ = refined(made)
    spread = np.sqrt(np.diag(covariance_from_information(alone.solve_result.information)))
    for i, name in enumerate(("camera", "lidar")):
        T = invert_pose(alone.state.T_robot_sensor[name]) @ result.state.T_robot_sensor[name]
        assert np.abs(se3_log(T) / spread[6 * i : 6 * i + 6]).max() < 0.02, name
        assert abs(offset(made, alone, name)[0] - offset(made, result, name)[0]) < 1e-5


def test_the_error_of_a_view_in_motion_is_the_one_that_an_unknown_of_its_own_would_take():
    """Eliminated by hand, against the normal equations with the error among the unknowns."""
    made = recorded(0.01, views=1, sensors=("camera",))
    state = initial_state(made, TRUE_POSES, 1.0)
    state.moving_view_errors[:] = 1e-4
    assigned = assign_measurements(made, state)
    part = linearize_measurements(made, build_nlp(made), state, assigned)[-1]
    plain = replace(part, view_covariance=None, view_error=None)
    E = np.concatenate([np.eye(6), np.zeros((0, 6))])
    across = plain.dpose_dx.T @ plain.pose_information @ E
    across[-1] += plain.pose_theta_information[:, 0]
    own = plain.pose_information + np.linalg.inv(part.view_covariance)
    slope = plain.pose_gradient + np.linalg.solve(part.view_covariance, part.view_error)
    expected = plain.hessian_x - across @ np.linalg.solve(own, across.T)
    np.testing.assert_allclose(
        part.hessian_x, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max()
    )
    expected = plain.gradient_x - across @ np.linalg.solve(own, slope)
    np.testing.assert_allclose(
        part.gradient_x, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max()
    )
    step = 1e-3 * np.arange(len(part.columns))
    found = part.update_view_error(step) - part.view_error
    np.testing.assert_allclose(
        found, -np.linalg.solve(own, slope + across.T @ step), rtol=1e-5, atol=1e-9
    )
