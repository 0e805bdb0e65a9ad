"""The robot's markers, knocked within a session: named with the placement, before bumps of all."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.suspected_errors import find_suspected_errors
from calib.estimation.corrections.correction_catalog import list_corrections_and_shifts
from calib.geometry.se3 import invert_pose, se3_exp
from calib.geometry.units import NS_PER_S
from helpers.synthetic_setup import make_synthetic_setup, solve_synthetic_setup

LAYOUT = [("cylinder" if k in (2, 6) else "board", None) for k in range(10)]
KNOCK = np.array([0.003, -0.007, 0.002, 0.004, -0.002, 0.006])  # m, rad: 7.9 mm and 0.43°
WIDE_SIGMA = np.repeat([0.003, np.radians(0.1)], 3)


def suspicions(first_after, mocap_sigma=None, seed=0, times=False):
    """Those of a session whose robot's markers sit elsewhere from a placement on, from 0.

    times: placements rest from 4 to 0 s before every eighth second; the log starts at 10 s.
    """
    made = make_synthetic_setup(seed, LAYOUT)
    places = []
    for k, p in enumerate(made.placements):
        T = invert_pose(se3_exp(KNOCK)) @ p.T_robot_body if k >= first_after else p.T_robot_body
        sigma = p.mocap_sigma if mocap_sigma is None else mocap_sigma
        places.append(replace(p, T_robot_body=T, mocap_sigma=sigma))
        if times:
            span = {"start_ns": (4 + 8 * k) * NS_PER_S, "end_ns": (8 + 8 * k) * NS_PER_S}
            places[-1] = replace(places[-1], **span)
    made = replace(made, placements=places, log_starts_ns={"s": 10 * NS_PER_S} if times else {})
    result = solve_synthetic_setup(made, max_rounds=20)
    return find_suspected_errors(made, result, list_corrections_and_shifts(made))


@pytest.mark.parametrize("first_after", [3, 5, 8])
def test_a_knock_is_named_first_with_its_placement_and_its_size(first_after):
    first, *others = suspicions(first_after)
    assert (first["name"], first["subject"]) == ("robot_knock", "s")
    assert f"from its placement {first_after + 1} in session s on" in first["description"]
    np.testing.assert_allclose(first["estimate"], KNOCK, atol=0.001)
    assert "remounted: true" in first["remedy"]
    assert others == []
    assert first["pose_shift"]["camera"]["m"] > 0.001


def test_a_wide_sigma_of_the_motion_capture_does_not_hide_it():
    first = suspicions(5, WIDE_SIGMA)[0]
    assert first["name"] == "robot_knock" and first["p_value"] < 1e-5
    assert "from its placement 6 in session s on" in first["description"]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_of_markers_that_stay_nothing_is_suspected(seed):
    assert suspicions(len(LAYOUT), seed=seed) == []


def test_of_markers_that_stay_nothing_is_suspected_under_a_wide_sigma():
    assert suspicions(len(LAYOUT), WIDE_SIGMA) == []


def test_the_change_of_the_config_cuts_the_session_between_two_rests():
    """Log from 10 s; the rest before the knock ends at 40 s, that after it starts at 44 s."""
    first = suspicions(5, times=True)[0]
    key = "sessions.s.remounted_at_s"
    assert first["change"] == {"file": "config/config.yaml", "key": key, "value": 32.0}
    assert f"set {key}: 32.0" in first["remedy"]
