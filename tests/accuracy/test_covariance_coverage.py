"""Draws of measurements and of noise: what the benchmark's statistics rest on."""

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarking.accuracy import covariance_coverage, exact_observations
from benchmarking.accuracy.covariance_coverage import (
    COVERAGE_CASES,
    add_measurement_noise,
    compute_coverage,
    draw_coverage_error,
    make_coverage_case,
)
from benchmarking.accuracy.cramer_rao_bound import compute_cramer_rao_bound
from benchmarking.accuracy.draw_statistics import compute_draw_statistics
from benchmarking.accuracy.error_metrics import sigma_mm_deg
from benchmarking.accuracy.noise_draws import (
    compute_draw_references,
    redraw_and_estimate,
    redraw_placements,
    redraw_views,
)
from benchmarking.accuracy.simulated_session import make_simulated_session, select_kept_views
from calib.estimation.estimate_state import initial_state
from calib.estimation.measurement_assignment import assign_measurements
from calib.estimation.problem_assembly import SessionKeypoints, build_setup
from calib.geometry.se3 import invert_pose, pose_from_xyz_quat, pose_to_quat, se3_log
from calib.io.config import validate_and_complete
from simulate import draw_sessions, parse_simulation_arguments

SEEN = ("velodyne", "camera")
VIEWS = 2


@pytest.fixture(scope="module")
def seen():
    """A lidar and a camera that see a board five times."""
    return make_coverage_case("--rig sim --targets board --placements 5", SEEN)


# --- observations


def exactly(case):
    """The Setup of a Geometry without any noise."""
    sessions = [
        SessionKeypoints(k, pairs, case.placements[k], case.T_robot_sensor)
        for k, pairs in case.measurements.items()
    ]
    return build_setup(sessions, {}, case.options)[0]


def test_exact_measurements_leave_no_residual_at_the_truth():
    case = make_coverage_case(*COVERAGE_CASES["two lidars and two cameras"])
    setup = exactly(case)
    state = initial_state(setup, case.T_robot_sensor, 1.0)
    largest = {
        "target_surface": 1e-9,
        "board_outline": 2e-6,
        "pattern_corner": 1e-6,
        "cylinder_limb": 1e-6,
    }  # m, rad, px, px
    for g, a in zip(setup.groups, assign_measurements(setup, state), strict=True):
        assert np.abs(a.residual).max() < largest[g.kind], g.kind


def test_every_sensor_of_every_geometry_sees_ten_placements_or_more_points_than_unknowns():
    for arguments, names in COVERAGE_CASES.values():
        case = make_coverage_case(arguments, names)
        for name in names:
            rows = [(p["sensor"] == name).sum() for p in case.measurements.values()]
            assert sum(rows) > 6 * 20


def test_a_crossing_errs_alike_in_every_scan_and_uniformly_within_a_step(seen):
    (columns,) = seen.measurements.values()
    noisy = add_measurement_noise(columns, seen, np.random.default_rng(0))
    rows = columns["kind"] == "board_outline"
    turn = np.arctan2(noisy["xyz"][rows, 1], noisy["xyz"][rows, 0])
    turn -= np.arctan2(columns["xyz"][rows, 1], columns["xyz"][rows, 0])
    step = columns["sigma"][rows][0] * np.sqrt(12)
    assert np.abs(turn).max() <= step / 2 and np.std(turn) == pytest.approx(step / 12**0.5, 0.15)
    for number in set(columns["placement"][rows].tolist()):
        first, second = (
            turn[(columns["placement"][rows] == number) & (columns["view"][rows] % 2 == v)]
            for v in (0, 1)
        )
        assert first == pytest.approx(second, abs=1e-12)


def test_the_covariance_of_a_lidar_and_a_camera_holds_what_it_promises(seen):
    found = compute_coverage("", SEEN, [draw_coverage_error(seen, seed) for seed in range(20)])
    for name, size in found.n_dof.items():
        low, high = chi2.ppf([5e-4, 1 - 5e-4], 20 * size) / (20 * size)
        assert low < found.mean_nees[name] < high, name
        assert found.share_covered[name] > 0.8


# --- the reference


def spread(placements, monkeypatch):
    """(with, without) outlines: mm, one scan of 1 cm of every placement, no noise of the MCS."""
    monkeypatch.setattr(exact_observations, "MAX_RETURNS", 10_000)
    monkeypatch.setattr(covariance_coverage, "N_VIEWS_PER_PLACEMENT", 1)
    arguments = (
        f"--rig round --targets board --placements {placements} --seed 2 --range-noise-m 0.01"
    )
    arguments += " --mcs-noise-m 0 --mcs-noise-deg 0 --mcs-bias-m 0 --mcs-bias-deg 0"
    case = make_coverage_case(arguments, ("velodyne",))
    found = compute_cramer_rao_bound(exactly(case), case.T_robot_sensor, 0.01)
    return [
        sigma_mm_deg(c["velodyne"])[0]
        for c in (found.covariance, found.covariance_without_outlines)
    ]


@pytest.mark.parametrize(("placements", "expected"), [(5, 0.28), (15, 0.15), (30, 0.10)])
def test_the_reference_is_as_large_as_was_found_for_such_a_board(placements, expected, monkeypatch):
    whole, inside = spread(placements, monkeypatch)
    assert whole == pytest.approx(expected, rel=0.2)
    assert inside / whole == pytest.approx(2, rel=0.15) or placements == 5


def test_repeated_scans_add_returns_to_the_reference_but_no_crossings(seen, monkeypatch):
    monkeypatch.setattr(covariance_coverage, "N_VIEWS_PER_PLACEMENT", 8)
    often = make_coverage_case("--rig sim --targets board --placements 5", SEEN)
    once, eight = (
        compute_cramer_rao_bound(exactly(c), c.T_robot_sensor, 1e3) for c in (seen, often)
    )
    information = [np.linalg.inv(f.covariance["velodyne"]) for f in (once, eight)]
    assert information[1] == pytest.approx(
        information[0], rel=1e-3, abs=1e-3 * information[0].max()
    )


# --- draws of the noise


@pytest.fixture(scope="module")
def recorded():
    """A simulated session of a lidar and a board at four placements, made without the pipeline."""
    noise = "--range-noise-m 0.008 --mcs-noise-m 0.00015 --mcs-noise-deg 0.02"
    text = f"- --targets board --placements 4 --guess-error-deg 2 {noise}"
    args = parse_simulation_arguments(text.split())
    (session,), guesses = draw_sessions(args)
    T = invert_pose(session.placement_poses["robot"]) @ session.placement_poses["board"]
    trimmed = session.placement_times_ns + [100_000_000, -100_000_000]
    placements = {
        "placement": np.arange(len(T)),
        "target": np.full(len(T), "board"),
        "kind": np.full(len(T), "still"),
        "start_ns": trimmed[:, 0],
        "end_ns": trimmed[:, 1],
        "xyz": T[:, :3, 3],
        "quat": pose_to_quat(T),
        "samples": np.full(len(T), 80),
        "effective_samples": np.full(len(T), 80.0),
        "mean_pose_sigma_factor": np.full(len(T), 80**-0.5),
        "residual_drift": np.zeros((len(T), 6)),
        **{
            f"{name}_slow_{quantity}": np.zeros((len(T), 6))
            for name in ("robot", "body")
            for quantity in ("sigma", "time_s")
        },
        "covariance": np.zeros((len(T), 36)),
    }
    number = np.repeat(np.arange(len(T)), VIEWS)
    views = {
        "view": np.arange(len(number)),
        "stamp_ns": trimmed[number, 0] + 100_000_000 * (np.arange(len(number)) % VIEWS),
        "target": np.full(len(number), "board"),
        "placement": number,
        "kept": np.full(len(number), True),
        "reason": np.full(len(number), ""),
        **{k: [[] for _ in number] for k in ("xyz", "ring", "point_time_ns", "intensity")},
    }
    guess = {
        "T_robot_sensor": {"matrix": guesses["velodyne"].tolist()},
        "sigma": [0.0173] * 3 + [0.02] * 3,
        "mounts": {},
        "status": {"ok": True, "reason": ""},
    }
    settings = validate_and_complete(
        "config", {"sessions": {"a": {"rig": "a", "log": "a"}}}, "config"
    )
    return make_simulated_session(
        args,
        "velodyne",
        "board",
        settings,
        placements=placements,
        views=views,
        guess=guess,
    )


@pytest.fixture(scope="module")
def drawn(recorded):
    """Four draws of it, by seed."""
    return [redraw_and_estimate(recorded, seed) for seed in range(4)]


def test_a_draw_is_the_same_again_and_another_seed_is_another(recorded, drawn):
    again = redraw_and_estimate(recorded, 1)
    assert np.array_equal(drawn[1].error, again.error)
    assert np.array_equal(drawn[1].covariance, again.covariance)
    assert not np.allclose(drawn[1].error, drawn[2].error, rtol=0.01)


def test_draws_of_noise_err_as_the_reference_and_their_sigma_say(recorded, drawn):
    found = compute_draw_statistics(drawn, *compute_draw_references(recorded))
    assert np.all(np.divide(found.rms_error, found.reference) < 1.9)
    assert 0.3 < found.mean_nees < 2.4


def test_a_draw_turns_the_pattern_by_less_than_half_a_step_anew_at_every_placement(recorded):
    step = recorded.sensor_model.azimuth_step
    before, after = recorded.view_columns, redraw_views(recorded, np.random.default_rng(3))
    turns = []
    for k in sorted(recorded.exact_data):
        nominal = recorded.exact_data[k][0].beam_directions[:, 0]
        for i in select_kept_views(recorded, k):
            p = np.reshape(after["xyz"][i], (-1, 3)).astype(float)
            flat = np.arctan2(p[:, 1], p[:, 0]) - np.arctan2(nominal[0, 1], nominal[0, 0])
            turns.append(np.median((flat + step / 2) % step - step / 2))
    assert len(set(np.round(turns, 6))) == len(recorded.exact_data) and len(
        before["stamp_ns"]
    ) == len(turns)
    assert np.abs(turns).max() <= step / 2


def test_poses_of_the_mcs_are_averaged_from_fresh_samples(recorded):
    tables = [redraw_placements(recorded, np.random.default_rng(s)) for s in range(20)]
    T = np.stack([pose_from_xyz_quat(t["xyz"], t["quat"]) for t in tables])
    xi = se3_log(invert_pose(T[:1]) @ T)[1:]
    factor = np.mean([t["mean_pose_sigma_factor"] for t in tables])
    assert 0.08 < factor < 0.16
    # Two bodies' angles and two draws: 2 σ of 0.02° over the root of the samples.
    assert np.std(xi[..., 3:]) == pytest.approx(2 * np.radians(0.02) * factor, rel=0.3)
