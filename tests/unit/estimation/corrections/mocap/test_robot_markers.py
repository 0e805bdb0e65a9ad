"""Robot markers mounted anew between sessions: where they sit is estimated, no sensor moves."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.session_repeatability import repeatability_json
from calib.estimation.corrections.mocap.robot_markers import (
    MARKERS_PRIOR_SIGMA,
    make_markers_corrections,
    robot_markers_json,
)
from calib.estimation.estimate_state import initial_state
from calib.estimation.measurement_assignment import assign_measurements
from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.estimation.round_solution import correction_derivatives
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import invert_pose, se3_exp, se3_log
from helpers import synthetic_setup
from helpers.synthetic_sessions import SESSION_LIMITS, make_two_sessions

ANEW = se3_exp(np.array([0.03, -0.02, 0.01, 0.05, -0.03, 0.08]))  # 3.7 cm, 5.7°


def remounted(seeds=(0, 1), told=True):
    """A Setup of two sessions, the robot's markers elsewhere by ANEW in the second."""
    made = make_two_sessions(seeds=seeds)
    back = invert_pose(ANEW)
    places = [
        replace(p, T_robot_body=back @ p.T_robot_body) if p.session == "morning" else p
        for p in made.placements
    ]
    poses = synthetic_setup.TRUE_POSES
    there = {n: back @ T for n, T in poses.items()}
    anew = make_markers_corrections({"evening": poses, "morning": there}, ["morning"])
    return replace(made, placements=places, corrections=tuple(anew) if told else ())


def solved(made):
    start = {n: synthetic_setup.TRUE_POSES[n] @ se3_exp(np.full(6, 0.003)) for n in made.models}
    return estimate_poses(made, start, **SESSION_LIMITS)


@pytest.mark.slow
def test_markers_and_sensors_are_found_by_their_sigma():
    """Of 10 draws: NEES/6 of the markers and of each sensor in bands of 99.9 %, [0.47, 1.80]."""
    nees = {"markers": [], "camera": [], "lidar": []}
    for k in range(10):
        made = remounted(seeds=(2 * k, 2 * k + 1))
        result = solved(made)
        told = robot_markers_json(made, result)["morning"]
        off = invert_pose(ANEW) @ np.array(told["T_robot_markers"]["matrix"])
        pairs = {"markers": (off, np.array(told["covariance"]))}
        spread = covariance_from_information(result.solve_result.information)
        for i, name in enumerate(sorted(made.models)):
            T = invert_pose(synthetic_setup.TRUE_POSES[name]) @ result.state.T_robot_sensor[name]
            pairs[name] = T, spread[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
        for name, (T, C) in pairs.items():
            xi = se3_log(T)
            nees[name].append(xi @ np.linalg.solve(C, xi) / 6)
    for name, found in nees.items():
        assert 0.47 < np.mean(found) < 1.80, name


def test_with_the_markers_estimated_no_sensor_seems_to_have_moved():
    made = remounted()
    rows = repeatability_json(made, solved(made), **SESSION_LIMITS)
    assert len(rows) == 4 and min(r["p_value"] for r in rows) > 1e-3


def test_without_a_word_of_it_every_sensor_seems_to_have_moved():
    made = remounted(told=False)
    rows = repeatability_json(made, solved(made), **SESSION_LIMITS)
    assert max(r["p_value"] for r in rows) < 1e-12


def test_slopes_by_the_markers_are_those_of_the_residuals():
    made = remounted()
    state = initial_state(made, synthetic_setup.TRUE_POSES, 1.0)
    assigned = assign_measurements(made, state)
    slopes = correction_derivatives(made, state, assigned)
    step = np.zeros(6)
    step[[1, 5]] = 2e-6
    moved = assign_measurements(
        made, replace(state, correction_values=state.correction_values + step)
    )
    for a, b, slope in zip(assigned, moved, slopes, strict=True):
        same = (a.feature >= 0) & (a.feature == b.feature)
        expected = (
            np.tensordot(step / MARKERS_PRIOR_SIGMA, slope, 1)
            if len(slope)
            else 0 * a.standardized.T
        )
        np.testing.assert_allclose(
            (b.standardized - a.standardized).T[:, same], expected[:, same], atol=2e-4
        )


def test_if_all_sessions_were_mounted_anew_the_first_defines_the_robot_frame():
    found = make_markers_corrections({"a": {}, "b": {}, "c": {}}, ["a", "b", "c"])
    assert [h.subject for h in found] == ["b", "c"]
    assert make_markers_corrections({"a": {}, "b": {}}, []) == []
    np.testing.assert_array_equal(found[0].initial_values, np.zeros(6))


def test_the_start_is_where_a_sensor_of_both_sessions_puts_the_markers():
    (found,) = remounted().corrections
    np.testing.assert_allclose(se3_exp(found.initial_values), ANEW, atol=1e-12)
    assert found.subject == "morning" and found.initial_values.max() == pytest.approx(0.08)
