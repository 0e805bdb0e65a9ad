"""Poses as the report tells them: numbers, their σ, and their error where truth is known."""

import numpy as np
import pytest

from calib.geometry.se3 import make_pose, pose_from_rpy, se3_exp, so3_exp
from calib.report.sections.extrinsics import (
    NEES_PER_DOF_95,
    is_gimbal_locked,
    pose_error_nees,
    xyz_rpy_difference,
    xyz_rpy_sigma,
)
from helpers.report_inputs import POSE_SIGMA, T_ROBOT_SENSOR, extract_page_text


def test_sigmas_are_those_of_the_numbers_beside_them():
    for T in (*T_ROBOT_SENSOR.values(), pose_from_rpy([1, 2, 3], [0.4, -0.7, 2.1])):
        step = 1e-6
        moved = [T @ se3_exp(step * axis) for axis in np.eye(6)]
        J = np.array([xyz_rpy_difference(there, T) for there in moved]).T / step
        told = xyz_rpy_sigma(T, np.diag(POSE_SIGMA**2))
        np.testing.assert_allclose(np.sqrt((J * POSE_SIGMA) ** 2 @ np.ones(6)), told, rtol=1e-4)


@pytest.mark.parametrize("pitch_deg", [90.0, 89.0, -90.0, -87.0])
def test_near_a_pitch_of_90_deg_sigmas_and_differences_are_of_turns_about_the_robot(pitch_deg):
    """Roll and yaw alone would be unsure by 57 times as much at 89°, and by all at 90°."""
    T = pose_from_rpy([1, 2, 3], [0.3, np.radians(pitch_deg), 0.1])
    told = xyz_rpy_sigma(T, np.diag(POSE_SIGMA**2))
    turned = T[:3, :3] @ np.diag(POSE_SIGMA[3:] ** 2) @ T[:3, :3].T
    np.testing.assert_allclose(told[3:], np.degrees(np.sqrt(np.diag(turned))))
    assert is_gimbal_locked(T)
    about_z = make_pose(so3_exp([0.0, 0.0, np.radians(0.5)]), None)
    moved = make_pose(about_z[:3, :3] @ T[:3, :3], T[:3, 3])
    np.testing.assert_allclose(xyz_rpy_difference(moved, T), [0, 0, 0, 0, 0, 0.5], atol=1e-9)


def test_a_pitch_of_80_deg_has_angles_of_its_own():
    T = pose_from_rpy([1, 2, 3], [0.3, np.radians(80), 0.1])
    assert not is_gimbal_locked(T)


def test_angles_differ_by_less_than_half_a_turn():
    one, other = (pose_from_rpy([0, 0, 0], np.radians([0, 0, yaw])) for yaw in (179, -179))
    assert xyz_rpy_difference(other, one)[5] == pytest.approx(2)


def test_the_error_of_draws_from_the_covariance_is_one_sigma():
    rng = np.random.default_rng(2)
    P, T = np.diag(POSE_SIGMA**2), T_ROBOT_SENSOR["left"]
    xi = POSE_SIGMA * rng.standard_normal((300, 6))
    nees = [pose_error_nees(T @ se3_exp(x), P, T)[2] for x in xi]
    assert np.mean(nees) == pytest.approx(1, abs=0.15)
    inside = np.mean([NEES_PER_DOF_95[0] < v < NEES_PER_DOF_95[1] for v in nees])
    assert inside == pytest.approx(0.95, abs=0.03)


def test_truth_is_shown_beside_the_results(report_files):
    report_files.options["report"]["max_overlays"] = 1
    off = se3_exp([0.002, 0, 0, 0, 0, 0])
    report_files.options["truth"] = {
        n: {"matrix": (T @ off).tolist()} for n, T in T_ROBOT_SENSOR.items()
    }
    said = extract_page_text(report_files.render_report())
    # 2 mm along an axis of σ 1 mm: NEES 4.
    assert "error against the truth 2 mm, 0° (0.82 σ, NEES/6 0.67)" in said
    assert "The truth is known; only this report uses it." in said
    assert "dashed outline: by the truth" in said


def test_truth_may_be_known_of_one_sensor_alone(report_files, skip_figures):
    report_files.options["truth"] = {"top": {"matrix": T_ROBOT_SENSOR["top"].tolist()}}
    said = extract_page_text(report_files.render_report())
    assert said.count("error against the truth 0 mm, 0°") == 1


def test_a_truth_of_a_sensor_that_the_rig_does_not_use_is_named(report_files, skip_figures):
    report_files.options["truth"] = {"tpo": {"matrix": T_ROBOT_SENSOR["top"].tolist()}}
    said = extract_page_text(report_files.render_report())
    assert "The rig states the truth of tpo, but rig robo does not use this name" in said
    assert "error against the truth" not in said


def test_without_truth_nothing_is_said_of_it(good_report_page):
    assert "truth" not in extract_page_text(good_report_page)
