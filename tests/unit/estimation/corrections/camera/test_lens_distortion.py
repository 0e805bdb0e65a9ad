"""Distortion that the stated lens lacks: named with its size, beside what else is wrong with it."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.correction_selection import estimate_with_corrections
from calib.diagnosis.suspected_errors import find_suspected_errors
from calib.estimation.corrections.camera.lens_distortion import (
    make_distortion_corrections,
    stated_distortion,
)
from calib.estimation.corrections.correction_catalog import (
    list_corrections_and_shifts,
    list_testable_corrections,
)
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.geometry.se3 import invert_pose, se3_exp, se3_log
from calib.sensors.camera.camera_model import CameraModel
from helpers import synthetic_setup
from helpers.synthetic_setup import (
    CAMERA_MODEL,
    SyntheticWorld,
    make_synthetic_setup,
    solve_synthetic_setup,
)

LAYOUT = [("board", None)] * 10
SURE = 1e-5  # the judge's own limit on the chance
FISHEYE = CameraModel(
    "kannala_brandt", (420, 420, 450, 350, 0.03, -0.01, 0.004, -0.001), (900, 700)
)
WIDE = CameraModel("double_sphere", (300, 300, 450, 350, -0.2, 0.55), (900, 700))
LIMITS = {
    "max_rounds": 40,
    "tolerance_m": 1e-7,
    "tolerance_rad": 1e-7,
    "initial_noise_factor": 300.0,
}


def shifted(camera, **changes):
    """The camera with some parameters changed, by name."""
    params = np.array(camera.params)
    for name, change in changes.items():
        params[camera.lens.PARAMETER_NAMES.index(name)] += change
    return replace(camera, params=tuple(params))


def setup_of(lens, stated=CAMERA_MODEL, seed=0):
    """Views by a lens of which the Setup knows what is stated."""
    made = make_synthetic_setup(seed, LAYOUT, SyntheticWorld(camera=lens))
    return replace(made, models=made.models | {"camera": stated})


def found(lens, stated=CAMERA_MODEL, seed=0):
    """Suspicions that the judge would believe."""
    made = setup_of(lens, stated, seed)
    result = solve_synthetic_setup(made, max_rounds=20)
    told = find_suspected_errors(made, result, list_corrections_and_shifts(made))
    return [s for s in told if s["p_value"] < SURE]


@pytest.mark.parametrize("seed", range(3))
def test_a_lens_stated_without_its_distortion_is_named_first_with_k1_within_4_sigma(seed):
    lens = shifted(CAMERA_MODEL, k1=-0.08)
    first = found(lens, seed=seed)[0]
    assert (first["name"], first["subject"]) == ("distortion", "camera")
    k1, sigma = first["estimate"][0], first["sigma"][0]
    assert abs(k1 + 0.08) < 4 * sigma < 0.04
    assert first["pose_shift"]["camera"]["m"] > 0.0002


def test_the_words_tell_true_and_stated_values_and_the_key_that_mends_it():
    first = found(shifted(CAMERA_MODEL, k1=-0.08))[0]
    assert "distortion k1 -0.1" in first["description"] and " ± 0.0" in first["description"]
    assert "is not in the stated lens of camera (k1 -0.1" in first["description"]
    assert "p1" not in first["description"]  # which is right
    assert first["remedy"].startswith("set solve.estimate.intrinsics: true")


def test_a_tangential_term_is_named_with_its_size():
    first = found(shifted(CAMERA_MODEL, p1=0.004))[0]
    assert first["name"] == "distortion"
    assert first["estimate"][2] == pytest.approx(0.004, abs=4 * first["sigma"][2])


@pytest.mark.parametrize(
    ("lens", "stated", "parameter"),
    [
        (FISHEYE, shifted(FISHEYE, k1=0.04), "k1"),
        (WIDE, shifted(WIDE, alpha=-0.04), "alpha"),
    ],
)
def test_wide_lenses_have_their_own_parameters_tried(lens, stated, parameter):
    first = found(lens, stated)[0]
    names = list(stated_distortion(stated))
    assert first["name"] == "distortion" and f" {parameter} " in first["description"]
    off = first["estimate"][names.index(parameter)]
    truth = lens.params[4 + names.index(parameter)] - stated.params[4 + names.index(parameter)]
    assert off == pytest.approx(truth, abs=4 * first["sigma"][names.index(parameter)])


@pytest.mark.parametrize("camera", [CAMERA_MODEL, FISHEYE, WIDE])
def test_of_a_lens_that_is_as_stated_no_distortion_is_suspected(camera):
    assert found(camera, camera) == []


def test_a_wrong_focal_length_beside_a_wrong_distortion_is_named_too():
    told = found(shifted(CAMERA_MODEL, k1=-0.08, fx=8.0, fy=8.0))
    focal = next(s for s in told if s["name"] == "focal_length")
    assert {s["name"] for s in told} == {"distortion", "focal_length"}
    assert focal["estimate"][0] == pytest.approx(0.01, abs=4 * focal["sigma"][0])


def test_the_derivatives_are_those_of_the_residuals_by_a_large_step():
    made = setup_of(CAMERA_MODEL)
    result = solve_synthetic_setup(made, max_rounds=6)
    (lens,) = make_distortion_corrections(made)
    at = [g.kind for g in made.groups].index("pattern_corner")
    group, assigned = made.groups[at], result.assignments[at]
    view = GroupLinearization(made, result.state, CAMERA_MODEL, group, assigned, None)
    derivatives = lens.derivative(view)
    for i in range(lens.n_values):
        step = 1e-3 * np.eye(lens.n_values)[i]
        moved = view.residuals_with(model=lens.apply_to_model(CAMERA_MODEL, step, 0))
        slope = (moved - assigned.standardized.T) / 1e-3
        np.testing.assert_allclose(derivatives[i], slope, atol=0.02 * np.abs(slope).max())


def test_with_the_parameters_estimated_nothing_of_the_lens_is_tried_again():
    made = replace(setup_of(shifted(CAMERA_MODEL, k1=-0.08)), estimable_intrinsics={"camera": 8})
    start = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in synthetic_setup.TRUE_POSES.items()}
    made, result, told = estimate_with_corrections(made, start, {"intrinsics": True}, **LIMITS)
    assert told == []
    lens = {"distortion", "focal_length", "principal_point"}
    assert not lens & {c.name for c in list_testable_corrections(made)}
    truth = synthetic_setup.TRUE_POSES["camera"]
    off = se3_log(invert_pose(truth) @ result.state.T_robot_sensor["camera"])
    assert np.linalg.norm(off[:3]) < 0.003
