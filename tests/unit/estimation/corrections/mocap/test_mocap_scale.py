"""The scale of the motion capture: told from sizes and ranges by what sensors agree on."""

from dataclasses import replace

import numpy as np

from calib.diagnosis.correction_selection import estimate_with_corrections
from calib.estimation.corrections.mocap.mocap_scale import mocap_scales_json
from calib.geometry.se3 import invert_pose, make_pose, se3_exp, se3_log
from helpers import synthetic_setup
from helpers.synthetic_setup import SyntheticWorld, make_synthetic_setup, scale_pattern

MIXED = [("board", None)] * 7 + [("cylinder", None)] * 3
LIMITS = {
    "max_rounds": 30,
    "tolerance_m": 1e-6,
    "tolerance_rad": 1e-6,
    "initial_noise_factor": 100.0,
}
START = {n: T @ se3_exp(np.full(6, 0.005)) for n, T in synthetic_setup.TRUE_POSES.items()}
SCALE = -0.006  # distances too short
WIDE_SIGMA = np.repeat([0.003, np.radians(0.1)], 3)  # as the first remedy of old would have it


def setup_at_scale(error, *, mocap_sigma=None, world=None, sensors=("camera", "lidar")):
    """The Setup of a motion capture whose distances are too long by a share."""
    made = make_synthetic_setup(0, MIXED, world)
    places = []
    for p in made.placements:
        T = p.T_robot_body
        T = make_pose(T[:3, :3], (1 + error) * T[:3, 3])
        sigma = p.mocap_sigma if mocap_sigma is None else mocap_sigma
        places.append(replace(p, T_robot_body=T, mocap_sigma=sigma))
    groups = [g for g in made.groups if g.sensor in sensors]
    models = {n: m for n, m in made.models.items() if n in sensors}
    return replace(made, placements=places, groups=groups, models=models)


def refine(made, wanted="auto"):
    start = {n: START[n] for n in made.models}
    options = {"mocap_scale": wanted, "lidar_corrections": "auto"}
    return estimate_with_corrections(made, start, options, **LIMITS)


def errors_in_sigma(made, result):
    """Largest component of every pose's error, in its σ."""
    sigma = np.sqrt(np.diag(result.solved.covariance)).reshape(-1)[: 6 * len(made.models)]
    off = [
        se3_log(invert_pose(synthetic_setup.TRUE_POSES[n]) @ result.state.T_robot_sensor[n])
        for n in sorted(made.models)
    ]
    return np.abs(np.concatenate(off) / sigma).max()


def test_distances_0_6_percent_short_are_estimated_and_both_poses_are_right():
    made, result, suspected = refine(setup_at_scale(SCALE))
    scale = mocap_scales_json(made, result)["s"]
    assert abs(scale["value"] - SCALE) < 3 * scale["sigma"] < 0.002
    assert errors_in_sigma(made, result) < 3.5
    assert suspected == []


def test_a_wide_sigma_of_the_motion_capture_does_not_hide_it():
    """3 mm and 0.1° per pose, 30 times the true σ: at 1 % it is named as a likely error."""
    _, _, suspected = refine(setup_at_scale(0.01, mocap_sigma=WIDE_SIGMA), wanted=False)
    first = suspected[0]
    assert first["name"] == "mocap_scale" and first["p_value"] < 1e-5
    assert abs(first["estimate"][0] - 0.01) < 3 * first["sigma"][0]
    assert first["pose_shift"]["lidar"]["m"] > 0.01


def test_where_it_must_not_be_estimated_it_is_named_first_with_what_to_do():
    made, result, suspected = refine(setup_at_scale(SCALE), wanted=False)
    assert mocap_scales_json(made, result) == {}
    first = suspected[0]
    assert (first["name"], first["subject"]) == ("mocap_scale", "s")
    assert "% too short" in first["description"]
    assert "solve.estimate.mocap_scale: true" in first["remedy"]
    assert first["pose_shift"]["camera"]["m"] > 0.005
    assert abs(first["estimate"][0] - SCALE) < 3 * first["sigma"][0]


def test_squares_0_6_percent_larger_are_not_taken_for_a_scale():
    world = SyntheticWorld(targets=scale_pattern(1.006))
    made, result, suspected = refine(setup_at_scale(0.0, world=world))
    assert mocap_scales_json(made, result) == {}
    assert suspected[0]["name"] == "square_size"


def test_one_camera_alone_cannot_tell_a_scale_from_squares_so_nothing_is_corrected():
    made, result, suspected = refine(setup_at_scale(SCALE, sensors=("camera",)))
    assert mocap_scales_json(made, result) == {}
    first = suspected[0]
    names = {first["name"], *(a["name"] for a in first["alternatives"])}
    assert {"mocap_scale", "square_size"} <= names


def test_of_a_right_scale_nothing_is_said_even_if_the_stated_sigma_is_too_large():
    for mocap_sigma in (None, WIDE_SIGMA):
        made, _, suspected = refine(setup_at_scale(0.0, mocap_sigma=mocap_sigma))
        assert made.corrections == () and suspected == []


def test_where_it_is_asked_for_it_is_estimated_in_any_case_and_says_zero_of_a_right_one():
    made, result, _ = refine(setup_at_scale(0.0), wanted=True)
    scale = mocap_scales_json(made, result)["s"]
    assert abs(scale["value"]) < 3 * scale["sigma"] < 0.002
