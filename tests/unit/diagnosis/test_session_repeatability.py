"""Sessions: poses repeat by their σ, and a sensor that moved between them is named."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.session_repeatability import repeatability_json
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import se3_exp, se3_log
from helpers import synthetic_sessions, synthetic_setup
from helpers.synthetic_sessions import SENSOR_BUMP, SESSION_LIMITS


def told(made):
    start = {n: synthetic_setup.TRUE_POSES[n] @ se3_exp(np.full(6, 0.003)) for n in made.models}
    result = estimate_poses(made, start, **SESSION_LIMITS)
    return repeatability_json(made, result, **SESSION_LIMITS)


@pytest.mark.slow
def test_poses_of_sensors_that_stay_repeat_by_their_sigma():
    """Six pairs of sessions, two sensors each: chances spread as chances do."""
    chances = [
        row["p_value"]
        for k in range(6)
        for row in told(synthetic_sessions.make_two_sessions(seeds=(2 * k, 2 * k + 1)))
        if row["session"] == "evening"
    ]
    assert len(chances) == 12
    assert min(chances) > 1e-3 and 0.25 < np.mean(chances) < 0.75


@pytest.mark.slow
def test_a_camera_that_was_bumped_between_sessions_is_told_from_a_lidar_that_was_not():
    rows = {
        (r["session"], r["sensor"]): r
        for r in told(synthetic_sessions.make_two_sessions(moved=("camera",)))
    }
    assert rows["morning", "camera"]["p_value"] < 1e-12
    assert rows["morning", "lidar"]["p_value"] > 1e-3
    assert rows["morning", "camera"]["markers"]["explained_share"] < 0.9
    shift, sigma = (np.array(rows["morning", "camera"][k]) for k in ("shift", "sigma"))
    assert (np.abs(shift - se3_log(SENSOR_BUMP)) < 4 * sigma).all()
    np.testing.assert_allclose(shift, -np.array(rows["evening", "camera"]["shift"]), atol=1e-9)


def test_sensors_that_all_shift_with_the_markers_are_told_with_the_shift_of_these():
    """Both sensors see the robot's markers 4 mm and 0.6 degrees elsewhere in the second session."""
    T_markers = se3_exp(np.array([0.003, -0.002, 0.002, 0.0, 0.01, 0.0]))
    made = synthetic_sessions.make_two_sessions()
    places = [
        replace(p, T_robot_body=T_markers @ p.T_robot_body, start_ns=10**9)
        if p.session == "evening"
        else p
        for p in made.placements
    ]
    rows = told(replace(made, placements=places))
    assert [r["session"] for r in rows] == ["morning", "morning", "evening", "evening"]
    for row in rows[2:]:
        assert row["markers"]["explained_share"] > 0.95
        off = np.array(row["markers"]["shift"]) - se3_log(T_markers)
        assert np.linalg.norm(off[:3]) < 0.002 and np.linalg.norm(off[3:]) < 0.001


def test_one_session_alone_says_nothing_of_repeating():
    made = synthetic_sessions.make_two_sessions()
    alone = [replace(p, session="evening") for p in made.placements]
    assert told(replace(made, placements=alone)) == []


def test_a_session_without_a_sensor_is_no_matter():
    made = synthetic_sessions.make_two_sessions()
    second = {i for i, p in enumerate(made.placements) if p.session == "morning"}
    groups = [g for g in made.groups if not (g.sensor == "camera" and g.placement in second)]
    rows = told(replace(made, groups=groups))
    assert {(r["session"], r["sensor"]) for r in rows} == {
        ("evening", "lidar"),
        ("morning", "lidar"),
    }
