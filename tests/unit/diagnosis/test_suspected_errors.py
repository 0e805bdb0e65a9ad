"""Errors of the model that nobody estimates: the right one is named, of clean data none."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.suspected_errors import find_suspected_errors
from calib.estimation.corrections.camera.camera_intrinsics import make_intrinsics_correction
from calib.estimation.corrections.correction_catalog import (
    list_corrections_and_shifts,
    list_testable_corrections,
)
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.corrections.target_errors import _move_edges
from calib.estimation.nlp.measurement_factor import joint_information
from calib.geometry.se3 import invert_pose, make_pose, se3_exp
from helpers import synthetic_setup
from helpers.synthetic_setup import (
    BOARD_OUTLINE_M,
    CYLINDER_TARGET,
    N_RINGS,
    TARGETS_BY_NAME,
    SyntheticWorld,
    make_synthetic_setup,
    measure_target,
    scale_focal_length,
    scale_outline,
    scale_pattern,
    solve_synthetic_setup,
)

MIXED = [("board", None)] * 7 + [("cylinder", None)] * 3
SURE = 1e-5  # the judge's own limit on the chance
RADIUS = TARGETS_BY_NAME | {"cylinder": replace(CYLINDER_TARGET, radius=0.105)}


def found(world, seed=0):
    """Suspicions that the judge would believe."""
    made = make_synthetic_setup(seed, MIXED, world)
    return [
        s
        for s in find_suspected_errors(
            made, solve_synthetic_setup(made, max_rounds=20), list_corrections_and_shifts(made)
        )
        if s["p_value"] < SURE
    ]


WRONG = {
    "focal length 1 % longer": (
        SyntheticWorld(camera=scale_focal_length(1.01)),
        "focal_length",
        "camera",
        0.01,
    ),
    "outline 2 % larger": (
        SyntheticWorld(targets=scale_outline(1.02, 1.02)),
        "outline_size",
        "board",
        0.02,
    ),
    "radius 5 % larger": (SyntheticWorld(targets=RADIUS), "radius", "cylinder", 0.05),
    "ranges 20 mm long": (
        SyntheticWorld(range_bias_m=np.full(12, 0.02)),
        "range_bias",
        "lidar",
        0.02,
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_one_number_that_is_wrong_is_named_first_and_to_15_percent(case):
    world, name, of, size = WRONG[case]
    first = found(world)[0]
    assert (first["name"], first["subject"]) == (name, of)
    (estimate,), (sigma,) = first["estimate"], first["sigma"]
    assert abs(estimate - size) < 0.15 * size
    assert sigma < 0.15 * size


@pytest.mark.parametrize(("name", "axis"), [("board", 2), ("cylinder", 0), ("cylinder", 1)])
def test_a_target_frame_off_by_1_cm_is_named_with_its_direction(name, axis):
    off = np.zeros(3)
    off[axis] = 0.01
    told = found(SyntheticWorld(T_body_target={name: make_pose(None, off)}))
    if name == "cylinder" and axis == 0:
        assert told == []  # nothing in use tells where along its axis a cylinder sits
        return
    assert (told[0]["name"], told[0]["subject"]) == ("mount", name)
    np.testing.assert_allclose(told[0]["estimate"][:3], off, atol=0.0025)


def test_single_beams_that_read_14_mm_long_or_short_are_told_from_a_bias_of_all():
    signs = (-1.0) ** np.arange(N_RINGS)
    names = [s["name"] for s in found(SyntheticWorld(range_bias_m=0.014 * signs))]
    assert names == ["beam_offsets"]


def test_the_words_tell_the_number_its_sigma_and_what_to_write():
    first = found(SyntheticWorld(targets=scale_pattern(1.02)))[0]
    assert first["description"].startswith("the squares of board are ")
    assert "% larger than configured: square_m 0.0815" in first["description"]
    assert first["estimate"][0] == pytest.approx(0.02, rel=0.1)
    assert "calliper" in first["remedy"]
    assert first["pose_shift"]["camera"]["m"] > 0.02


def test_two_errors_at_once_are_both_named():
    world = SyntheticWorld(targets=scale_pattern(1.02) | {"cylinder": RADIUS["cylinder"]})
    assert {s["name"] for s in found(world)} == {"square_size", "radius"}


KNOCK = np.array([0.004, 0.0, 0.006, 0.0, 0.01, 0.0])  # m, rad


def test_a_target_that_is_knocked_half_way_is_named_with_when_and_by_how_much():
    made = make_synthetic_setup(0, [("board", None)] * 12)
    back = invert_pose(se3_exp(KNOCK))
    places = [
        replace(p, T_robot_body=p.T_robot_body @ back) if k >= 6 else p
        for k, p in enumerate(made.placements)
    ]
    made = replace(made, placements=places)
    first = find_suspected_errors(
        made, solve_synthetic_setup(made, max_rounds=20), list_corrections_and_shifts(made)
    )[0]
    assert (first["name"], first["subject"]) == ("target_slip", "board") and first["p_value"] < 1e-9
    assert "from its placement 7 in session s on" in first["description"]
    np.testing.assert_allclose(first["estimate"], KNOCK, atol=0.0025)
    assert not any(r["name"] == "target_slip" for r in first["alternatives"])


def test_a_sensor_that_is_bumped_half_way_is_named_with_when_and_by_how_much():
    made, world, rng = (
        make_synthetic_setup(0, [("board", None)] * 12),
        SyntheticWorld(),
        np.random.default_rng(1),
    )
    T = synthetic_setup.TRUE_POSES["camera"]
    elsewhere = T @ invert_pose(se3_exp(KNOCK)) @ invert_pose(T)
    exact = make_synthetic_setup(0, [("board", None)] * 12, mcs_noise_factor=0.0).placements
    groups = [g for g in made.groups if g.sensor == "lidar" or g.placement < 6]
    for k in range(6, 12):
        there = elsewhere @ exact[k].T_robot_body
        groups += measure_target(rng, world, "camera", k, "board", there)
    made = replace(made, groups=groups)
    first = find_suspected_errors(
        made, solve_synthetic_setup(made, max_rounds=20), list_corrections_and_shifts(made)
    )[0]
    assert (first["name"], first["subject"]) == ("sensor_bump", "camera") and first[
        "p_value"
    ] < 1e-9
    assert "from its placement 7 in session s on" in first["description"]
    np.testing.assert_allclose(first["estimate"], KNOCK, atol=0.0025)


@pytest.mark.parametrize("seed", [0, 1])
def test_of_clean_measurements_nothing_is_suspected(seed):
    assert found(SyntheticWorld(), seed=seed) == []


def test_the_derivatives_are_those_of_the_residuals_by_a_large_step():
    """Of the squares, over a step a thousand times as large as that of the differences."""
    made = make_synthetic_setup(0, MIXED[6:8])
    result = solve_synthetic_setup(made, max_rounds=6)
    squares = next(h for h in list_testable_corrections(made) if h.name == "square_size")
    at = [g.kind for g in made.groups].index("pattern_corner")
    group, assigned, part = made.groups[at], result.assignments[at], result.solve_result.factors[at]
    model = made.models[group.sensor]
    view = GroupLinearization(made, result.state, model, group, assigned, part.J_pose)
    grown = scale_pattern(1.001)["board"]
    slope = (view.residuals_with(target=grown) - assigned.standardized.T) / 1e-3
    np.testing.assert_allclose(squares.derivative(view)[0], slope, rtol=0.02, atol=0.1)


def test_a_measurement_at_the_rim_of_its_gate_keeps_its_derivative():
    """A step of a finite difference may take it across: its residual changes all the same."""
    made = make_synthetic_setup(0, MIXED[6:8])
    result = solve_synthetic_setup(made, max_rounds=6)
    at = [g.kind for g in made.groups].index("pattern_corner")
    group, assigned, part = made.groups[at], result.assignments[at], result.solve_result.factors[at]
    lens = make_intrinsics_correction("camera", made.models["camera"], 4)

    def derivative(gate):
        narrow = replace(made, associate_options=made.associate_options | {"gate_sigma": gate})
        there = replace(assigned, gate_sigma=gate)
        return lens.derivative(
            GroupLinearization(
                narrow, result.state, narrow.models["camera"], group, there, part.J_pose
            )
        )

    wide, rim = derivative(10.0), derivative(np.sort(assigned.standardized_norm)[9] * (1 + 1e-9))
    np.testing.assert_allclose(rim, wide, rtol=1e-9)
    assert np.abs(wide[3, 1]).min() > 10


def test_edges_move_outwards_by_what_is_said():
    moved = _move_edges(BOARD_OUTLINE_M, np.array([0.1, 0.0, 0.0, 0.2]))
    np.testing.assert_allclose(moved, [[0.7, 0.6], [-0.5, 0.6], [-0.5, -0.5], [0.7, -0.5]])
    clockwise = _move_edges(BOARD_OUTLINE_M[::-1], np.full(4, 0.1))
    np.testing.assert_allclose(np.abs(clockwise), 0.6)


def test_parts_of_the_solution_are_those_that_the_tests_expect():
    """Columns, A and information of every group: the sum with the priors is the information."""
    made = make_synthetic_setup(0, MIXED[6:8])
    solution = solve_synthetic_setup(made, max_rounds=6).solve_result
    weight = (np.arange(made.n_unknowns) >= made.n_pose_unknowns).astype(float)
    np.testing.assert_allclose(joint_information(solution.factors, weight), solution.information)
