"""Draws of measurements and of noise: what the benchmark's statistics rest on."""

import numpy as np
import pytest
from scipy.stats import chi2

import simulate
from benchmarking.accuracy import (
    covariance_coverage,
    cramer_rao_bound,
    draw_statistics,
    error_metrics,
    exact_observations,
    noise_draws,
    simulated_session,
)
from calib.estimation import estimate_state, problem_assembly, solver
from calib.geometry import se3
from calib.io import config

SEEN = ("velodyne", "camera")
VIEWS = 2


@pytest.fixture(scope="module")
def seen():
    """A lidar and a camera that see a board five times."""
    return covariance_coverage.geometry_of("--rig sim --targets board --placements 5", SEEN)


# --- observations


def exactly(case):
    """The Setup of a Geometry without any noise."""
    notes = {n: {"T_robot_sensor": T} for n, T in case.truth.items()}
    sessions = {k: (pairs, notes, case.places[k]) for k, pairs in case.pairs.items()}
    return problem_assembly.setup_of(sessions, {}, case.options)[0]


def test_exact_measurements_leave_no_residual_at_the_truth():
    case = covariance_coverage.geometry_of(*covariance_coverage.CASES["two lidars and two cameras"])
    setup = exactly(case)
    state = estimate_state.start(setup, case.truth, 1.0)
    largest = {"surface": 1e-9, "edge": 2e-6, "corner": 1e-6, "limb": 1e-6}  # m, rad, px, px
    for g, a in zip(setup.groups, solver.assign_all(setup, state), strict=True):
        assert np.abs(a.value).max() < largest[g.kind], g.kind


def test_every_sensor_of_every_geometry_sees_ten_placements_or_more_points_than_unknowns():
    for arguments, names in covariance_coverage.CASES.values():
        case = covariance_coverage.geometry_of(arguments, names)
        for name in names:
            rows = [(p["sensor"] == name).sum() for p in case.pairs.values()]
            assert sum(rows) > 6 * 20


def test_a_crossing_errs_alike_in_every_scan_and_uniformly_within_a_step(seen):
    (columns,) = seen.pairs.values()
    noisy = covariance_coverage.noisy(columns, seen, np.random.default_rng(0))
    rows = columns["kind"] == "edge"
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
    found = covariance_coverage.coverage(
        "", SEEN, [covariance_coverage.draw(seen, seed) for seed in range(20)]
    )
    for name, size in found.size.items():
        low, high = chi2.ppf([5e-4, 1 - 5e-4], 20 * size) / (20 * size)
        assert low < found.nees[name] < high, name
        assert found.held[name] > 0.8


# --- the reference


def spread(placements, monkeypatch):
    """(with, without) outlines: mm, one scan of 1 cm of every placement, no noise of the MCS."""
    monkeypatch.setattr(exact_observations, "POINTS", 10_000)
    monkeypatch.setattr(covariance_coverage, "VIEWS", 1)
    arguments = (
        f"--rig round --targets board --placements {placements} --seed 2 --range-noise-m 0.01"
    )
    arguments += " --mcs-noise-m 0 --mcs-noise-deg 0 --mcs-bias-m 0 --mcs-bias-deg 0"
    case = covariance_coverage.geometry_of(arguments, ("velodyne",))
    found = cramer_rao_bound.evaluate(exactly(case), case.truth, 0.01)
    return [error_metrics.spread(c["velodyne"])[0] for c in (found.covariance, found.inside)]


@pytest.mark.parametrize(("placements", "expected"), [(5, 0.28), (15, 0.15), (30, 0.10)])
def test_the_reference_is_as_large_as_was_found_for_such_a_board(placements, expected, monkeypatch):
    whole, inside = spread(placements, monkeypatch)
    assert whole == pytest.approx(expected, rel=0.2)
    assert inside / whole == pytest.approx(2, rel=0.15) or placements == 5


def test_repeated_scans_add_returns_to_the_reference_but_no_crossings(seen, monkeypatch):
    monkeypatch.setattr(covariance_coverage, "VIEWS", 8)
    often = covariance_coverage.geometry_of("--rig sim --targets board --placements 5", SEEN)
    once, eight = (cramer_rao_bound.evaluate(exactly(c), c.truth, 1e3) for c in (seen, often))
    told = [np.linalg.inv(f.covariance["velodyne"]) for f in (once, eight)]
    assert told[1] == pytest.approx(told[0], rel=1e-3, abs=1e-3 * told[0].max())


# --- draws of the noise


@pytest.fixture(scope="module")
def recorded():
    """A lidar's Recording of a board at four placements, made without the pipeline."""
    noise = "--range-noise-m 0.008 --mcs-noise-m 0.00015 --mcs-noise-deg 0.02"
    text = f"- --targets board --placements 4 --guess-error-deg 2 {noise}"
    args = simulate.parse(text.split())
    (session,), guesses = simulate.draw(args)
    T = se3.inverse(session.knots["robot"]) @ session.knots["board"]
    trimmed = session.times + [100_000_000, -100_000_000]
    placements = {
        "placement": np.arange(len(T)),
        "target": np.full(len(T), "board"),
        "kind": np.full(len(T), "still"),
        "start": trimmed[:, 0],
        "end": trimmed[:, 1],
        "xyz": T[:, :3, 3],
        "quat": se3.to_quat(T),
        "samples": np.full(len(T), 80),
        "effective_samples": np.full(len(T), 80.0),
        "pose_factor": np.full(len(T), 80**-0.5),
        "creep": np.zeros((len(T), 6)),
        "covariance": np.zeros((len(T), 36)),
    }
    number = np.repeat(np.arange(len(T)), VIEWS)
    views = {
        "view": np.arange(len(number)),
        "t": trimmed[number, 0] + 100_000_000 * (np.arange(len(number)) % VIEWS),
        "target": np.full(len(number), "board"),
        "placement": number,
        "kept": np.full(len(number), True),
        "reason": np.full(len(number), ""),
        **{k: [[] for _ in number] for k in ("xyz", "ring", "dt")},
    }
    guess = {
        "T_robot_sensor": {"matrix": guesses["velodyne"].tolist()},
        "sigma": [0.0173] * 3 + [0.02] * 3,
        "mounts": {},
        "status": {"ok": True, "reason": ""},
    }
    settings = config.complete("config", {"sessions": {"a": {"rig": "a", "log": "a"}}}, "config")
    return simulated_session.filled(args, "velodyne", "board", settings, placements, views, guess)


@pytest.fixture(scope="module")
def drawn(recorded):
    """Four draws of it, by seed."""
    return [noise_draws.draw(recorded, seed) for seed in range(4)]


def test_a_draw_is_the_same_again_and_another_seed_is_another(recorded, drawn):
    again = noise_draws.draw(recorded, 1)
    assert np.array_equal(drawn[1].error, again.error)
    assert np.array_equal(drawn[1].covariance, again.covariance)
    assert not np.allclose(drawn[1].error, drawn[2].error, rtol=0.01)


def test_draws_of_noise_err_as_the_reference_and_their_sigma_say(recorded, drawn):
    found = draw_statistics.statistics(drawn, *noise_draws.limits(recorded))
    assert np.all(np.divide(found.rms, found.reference) < 1.9)
    assert 0.3 < found.nees < 2.4


def test_a_draw_turns_the_pattern_by_less_than_half_a_step_anew_at_every_placement(recorded):
    step = recorded.model.azimuth_step
    before, after = recorded.views, noise_draws.views_of(recorded, np.random.default_rng(3))
    turns = []
    for k in sorted(recorded.content):
        nominal = recorded.content[k][0].beams[:, 0]
        for i in simulated_session.rows_of(recorded, k):
            p = np.reshape(after["xyz"][i], (-1, 3)).astype(float)
            flat = np.arctan2(p[:, 1], p[:, 0]) - np.arctan2(nominal[0, 1], nominal[0, 0])
            turns.append(np.median((flat + step / 2) % step - step / 2))
    assert len(set(np.round(turns, 6))) == len(recorded.content) and len(before["t"]) == len(turns)
    assert np.abs(turns).max() <= step / 2


def test_poses_of_the_mcs_are_averaged_from_fresh_samples(recorded):
    tables = [noise_draws.placements_of(recorded, np.random.default_rng(s)) for s in range(20)]
    T = np.stack([se3.from_xyz_quat(t["xyz"], t["quat"]) for t in tables])
    xi = se3.se3_log(se3.inverse(T[:1]) @ T)[1:]
    factor = np.mean([t["pose_factor"] for t in tables])
    assert 0.08 < factor < 0.16
    # Two bodies' angles and two draws: 2 σ of 0.02° over the root of the samples.
    assert np.std(xi[..., 3:]) == pytest.approx(2 * np.radians(0.02) * factor, rel=0.3)
