"""Errors of the model that nobody estimates: the right one is named, of clean data none."""

from dataclasses import replace

import numpy as np
import pytest

import synthetic
from calib.diagnosis import suspected_errors
from calib.estimation.corrections import camera_intrinsics, correction_catalog
from calib.estimation.corrections.correction import View
from calib.estimation.corrections.correction_catalog import all_of
from calib.estimation.corrections.target_errors import _with_edges_moved
from calib.estimation.nlp.measurement_factor import information
from calib.geometry import se3
from synthetic import World, outline_scaled, pattern_scaled, setup, solved, zoomed

MIXED = [("board", None)] * 7 + [("cylinder", None)] * 3
SURE = 1e-5  # the judge's own limit on the chance
RADIUS = synthetic.TARGETS | {"cylinder": replace(synthetic.CYLINDER, radius=0.105)}


def found(world, seed=0):
    """Suspicions that the judge would believe."""
    made = setup(seed, MIXED, world)
    return [
        s
        for s in suspected_errors.suspicions(
            made, solved(made, rounds=20), correction_catalog.with_moves(made)
        )
        if s["chance"] < SURE
    ]


WRONG = {
    "focal length 1 % longer": (World(camera=zoomed(1.01)), "focal", "camera", 0.01),
    "outline 2 % larger": (World(targets=outline_scaled(1.02, 1.02)), "outline", "board", 0.02),
    "radius 5 % larger": (World(targets=RADIUS), "radius", "cylinder", 0.05),
    "ranges 20 mm long": (World(too_long=np.full(12, 0.02)), "range_bias", "lidar", 0.02),
}


@pytest.mark.parametrize("case", WRONG)
def test_one_number_that_is_wrong_is_named_first_and_to_15_percent(case):
    world, name, of, size = WRONG[case]
    first = found(world)[0]
    assert (first["name"], first["of"]) == (name, of)
    (estimate,), (sigma,) = first["estimate"], first["sigma"]
    assert abs(estimate - size) < 0.15 * size
    assert sigma < 0.15 * size


@pytest.mark.parametrize(("name", "axis"), [("board", 2), ("cylinder", 0), ("cylinder", 1)])
def test_a_target_frame_off_by_1_cm_is_named_with_its_direction(name, axis):
    off = np.zeros(3)
    off[axis] = 0.01
    told = found(World(mounts={name: se3.pose(None, off)}))
    if name == "cylinder" and axis == 0:
        assert told == []  # nothing in use tells where along its axis a cylinder sits
        return
    assert (told[0]["name"], told[0]["of"]) == ("frame", name)
    np.testing.assert_allclose(told[0]["estimate"][:3], off, atol=0.0025)


def test_single_beams_that_read_14_mm_long_or_short_are_told_from_a_bias_of_all():
    signs = (-1.0) ** np.arange(synthetic.RINGS)
    names = [s["name"] for s in found(World(too_long=0.014 * signs))]
    assert names == ["beams"]


def test_the_words_tell_the_number_its_sigma_and_what_to_write():
    first = found(World(targets=pattern_scaled(1.02)))[0]
    assert first["text"].startswith("the squares of board are ")
    assert "% larger than the config says: square_m 0.0815" in first["text"]
    assert first["estimate"][0] == pytest.approx(0.02, rel=0.1)
    assert "calliper" in first["remedy"]
    assert first["shift"]["camera"]["m"] > 0.02


def test_two_errors_at_once_are_both_named():
    world = World(targets=pattern_scaled(1.02) | {"cylinder": RADIUS["cylinder"]})
    assert {s["name"] for s in found(world)} == {"squares", "radius"}


KNOCK = np.array([0.004, 0.0, 0.006, 0.0, 0.01, 0.0])  # m, rad


def test_a_target_that_is_knocked_half_way_is_named_with_when_and_by_how_much():
    made = setup(0, [("board", None)] * 12)
    back = se3.inverse(se3.se3_exp(KNOCK))
    places = [
        replace(p, T_robot_body=p.T_robot_body @ back) if k >= 6 else p
        for k, p in enumerate(made.placements)
    ]
    made = replace(made, placements=places)
    first = suspected_errors.suspicions(
        made, solved(made, rounds=20), correction_catalog.with_moves(made)
    )[0]
    assert (first["name"], first["of"]) == ("slipped", "board") and first["chance"] < 1e-9
    assert "from its placement 7 in session s on" in first["text"]
    np.testing.assert_allclose(first["estimate"], KNOCK, atol=0.0025)
    assert not any(r["name"] == "slipped" for r in first["rivals"])


def test_a_sensor_that_is_bumped_half_way_is_named_with_when_and_by_how_much():
    made, world, rng = setup(0, [("board", None)] * 12), World(), np.random.default_rng(1)
    T = synthetic.TRUE["camera"]
    elsewhere = T @ se3.inverse(se3.se3_exp(KNOCK)) @ se3.inverse(T)
    exact = setup(0, [("board", None)] * 12, mcs=0.0).placements
    groups = [g for g in made.groups if g.sensor == "lidar" or g.placement < 6]
    for k in range(6, 12):
        there = elsewhere @ exact[k].T_robot_body
        groups += synthetic.measured(rng, world, "camera", k, "board", there)
    made = replace(made, groups=groups)
    first = suspected_errors.suspicions(
        made, solved(made, rounds=20), correction_catalog.with_moves(made)
    )[0]
    assert (first["name"], first["of"]) == ("bumped", "camera") and first["chance"] < 1e-9
    assert "from its placement 7 in session s on" in first["text"]
    np.testing.assert_allclose(first["estimate"], KNOCK, atol=0.0025)


@pytest.mark.parametrize("seed", [0, 1])
def test_of_clean_measurements_nothing_is_suspected(seed):
    assert found(World(), seed=seed) == []


def test_the_derivatives_are_those_of_the_residuals_by_a_large_step():
    """Of the squares, over a step a thousand times as large as that of the differences."""
    made = setup(0, MIXED[6:8])
    result = solved(made, rounds=6)
    squares = next(h for h in all_of(made) if h.name == "squares")
    at = [g.kind for g in made.groups].index("corner")
    group, assigned, part = made.groups[at], result.assigned[at], result.solution.parts[at]
    model = made.models[group.sensor]
    view = View(made, result.state, model, group, assigned, part.J)
    grown = pattern_scaled(1.001)["board"]
    slope = (view.changed(target=grown) - assigned.standard.T) / 1e-3
    np.testing.assert_allclose(squares.derivative(view)[0], slope, rtol=0.02, atol=0.1)


def test_a_measurement_at_the_rim_of_its_gate_keeps_its_derivative():
    """A step of a finite difference may take it across: its residual changes all the same."""
    made = setup(0, MIXED[6:8])
    result = solved(made, rounds=6)
    at = [g.kind for g in made.groups].index("corner")
    group, assigned, part = made.groups[at], result.assigned[at], result.solution.parts[at]
    lens = camera_intrinsics.lens("camera", made.models["camera"], 4)

    def derivative(gate):
        narrow = replace(made, associate=made.associate | {"gate_sigma": gate})
        there = replace(assigned, gate=gate)
        return lens.derivative(
            View(narrow, result.state, narrow.models["camera"], group, there, part.J)
        )

    wide, rim = derivative(10.0), derivative(np.sort(assigned.size)[9] * (1 + 1e-9))
    np.testing.assert_allclose(rim, wide, rtol=1e-9)
    assert np.abs(wide[3, 1]).min() > 10


def test_edges_move_outwards_by_what_is_said():
    moved = _with_edges_moved(synthetic.SQUARE, np.array([0.1, 0.0, 0.0, 0.2]))
    np.testing.assert_allclose(moved, [[0.7, 0.6], [-0.5, 0.6], [-0.5, -0.5], [0.7, -0.5]])
    clockwise = _with_edges_moved(synthetic.SQUARE[::-1], np.full(4, 0.1))
    np.testing.assert_allclose(np.abs(clockwise), 0.6)


def test_parts_of_the_solution_are_those_that_the_tests_expect():
    """Columns, A and information of every group: the sum with the priors is the information."""
    made = setup(0, MIXED[6:8])
    solution = solved(made, rounds=6).solution
    weight = (np.arange(made.n) >= made.poses).astype(float)
    np.testing.assert_allclose(information(solution.parts, weight), solution.information)
