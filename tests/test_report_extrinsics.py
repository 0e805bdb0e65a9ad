"""Poses as the report tells them: numbers, their σ, and their error where truth is known."""

import numpy as np
import pytest

from calib.geometry import se3
from calib.report.sections import extrinsics
from reporting import POSES, SIGMA, words


def test_sigmas_are_those_of_the_numbers_beside_them():
    for T in (*POSES.values(), se3.from_rpy([1, 2, 3], [0.4, -0.7, 2.1])):
        step = 1e-6
        moved = [T @ se3.se3_exp(step * axis) for axis in np.eye(6)]
        J = np.array([extrinsics.difference(there, T) for there in moved]).T / step
        told = extrinsics.sigmas(T, np.diag(SIGMA**2))
        np.testing.assert_allclose(np.sqrt((J * SIGMA) ** 2 @ np.ones(6)), told, rtol=1e-4)


@pytest.mark.parametrize("pitch_deg", [90.0, 89.0, -90.0, -87.0])
def test_near_a_pitch_of_90_deg_sigmas_and_differences_are_of_turns_about_the_robot(pitch_deg):
    """Roll and yaw alone would be unsure by 57 times as much at 89°, and by all at 90°."""
    T = se3.from_rpy([1, 2, 3], [0.3, np.radians(pitch_deg), 0.1])
    told = extrinsics.sigmas(T, np.diag(SIGMA**2))
    turned = T[:3, :3] @ np.diag(SIGMA[3:] ** 2) @ T[:3, :3].T
    np.testing.assert_allclose(told[3:], np.degrees(np.sqrt(np.diag(turned))))
    assert extrinsics.locked(T)
    about_z = se3.pose(se3.so3_exp([0.0, 0.0, np.radians(0.5)]), None)
    moved = se3.pose(about_z[:3, :3] @ T[:3, :3], T[:3, 3])
    np.testing.assert_allclose(extrinsics.difference(moved, T), [0, 0, 0, 0, 0, 0.5], atol=1e-9)


def test_a_pitch_of_80_deg_has_angles_of_its_own():
    T = se3.from_rpy([1, 2, 3], [0.3, np.radians(80), 0.1])
    assert not extrinsics.locked(T)


def test_angles_differ_by_less_than_half_a_turn():
    one, other = (se3.from_rpy([0, 0, 0], np.radians([0, 0, yaw])) for yaw in (179, -179))
    assert extrinsics.difference(other, one)[5] == pytest.approx(2)


def test_the_error_of_draws_from_the_covariance_is_one_sigma():
    rng = np.random.default_rng(2)
    P, T = np.diag(SIGMA**2), POSES["left"]
    xi = SIGMA * rng.standard_normal((300, 6))
    nees = [extrinsics.error(T @ se3.se3_exp(x), P, T)[2] for x in xi]
    assert np.mean(nees) == pytest.approx(1, abs=0.15)
    inside = np.mean([extrinsics.NEES_95[0] < v < extrinsics.NEES_95[1] for v in nees])
    assert inside == pytest.approx(0.95, abs=0.03)


def test_truth_is_shown_beside_the_results(files):
    files.options["report"]["max_overlays"] = 1
    off = se3.se3_exp([0.002, 0, 0, 0, 0, 0])
    files.options["truth"] = {n: {"matrix": (T @ off).tolist()} for n, T in POSES.items()}
    said = words(files.render())
    # 2 mm along an axis of σ 1 mm: NEES 4.
    assert "error against the truth 2 mm, 0° (0.82 σ, NEES/6 0.67)" in said
    assert "The truth was given, to this report alone." in said
    assert "dashed outline: by the truth" in said


def test_truth_may_be_known_of_one_sensor_alone(files, undrawn):
    files.options["truth"] = {"top": {"matrix": POSES["top"].tolist()}}
    said = words(files.render())
    assert said.count("error against the truth 0 mm, 0°") == 1


def test_a_truth_of_a_sensor_that_the_rig_does_not_use_is_told(files, undrawn):
    files.options["truth"] = {"tpo": {"matrix": POSES["top"].tolist()}}
    said = words(files.render())
    assert "A truth was given of tpo, which rig robo does not use" in said
    assert "error against the truth" not in said


def test_without_truth_nothing_is_said_of_it(page):
    assert "truth" not in words(page)
