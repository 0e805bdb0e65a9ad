"""Unknown mounts that nothing determines: of which sensors they leave the pose open."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.observability import direction_spread_deg, normals_and_axes
from calib.diagnosis.sensor_status import find_floating_sensors, find_floating_sensors_of_setup
from calib.geometry.se3 import make_pose, so3_exp
from calib.initial_guess.hand_eye import check_mount_placements, predict_mount_sigma
from calib.io.config import validate_and_complete
from calib.targets.target_shapes import target_from_config
from helpers.synthetic_setup import make_synthetic_setup

CHARUCO = {
    "body": "mocap/charuco",
    "shape": "board",
    "pattern": {
        "kind": "charuco",
        "squares": [5, 7],
        "square_m": 0.1,
        "marker_m": 0.075,
        "dictionary": "DICT_4X4_50",
    },
}


def poses_turned_by(*rms_deg, n=8, seed=3):
    """Poses (n, 4, 4) with rotations of these rms, deg, about x, y and z."""
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-np.sqrt(3), np.sqrt(3), (n, 3)) * np.radians(rms_deg)
    return np.array([make_pose(so3_exp(turn), rng.uniform(-1, 1, 3)) for turn in turns])


ABOUT_ONE_AXIS = poses_turned_by(40, 0, 0)
STATED = {"board": np.array([0.004] * 3 + [0.01] * 3)}


@pytest.mark.parametrize("rms_deg", [(4, 0, 0), (40, 0, 0), (0, 25, 0.1), (0, 0, 0)])
def test_rotations_about_one_axis_leave_a_mount_open_however_large(rms_deg):
    status = check_mount_placements(poses_turned_by(*rms_deg), has_camera_prior=False)
    assert status.reason == "T_body_target is not determined: all rotations are about one axis"
    assert status.found.startswith("8 placements, rotations about their main axes of ")
    assert status.found.endswith("°, 0°, 0° (rms)")


@pytest.mark.parametrize("rms_deg", [(4, 4, 0), (10, 8, 5), (40, 5, 0)])
def test_rotations_about_two_axes_determine_a_mount(rms_deg):
    assert check_mount_placements(poses_turned_by(*rms_deg), has_camera_prior=False).ok


def test_two_placements_determine_no_mount_even_with_a_camera_whose_pose_is_stated():
    status = check_mount_placements(poses_turned_by(20, 20, 0, n=2), has_camera_prior=True)
    assert (status.found, status.expected) == ("2 placements", "3 or more")


def test_the_sigma_of_a_mount_falls_with_the_second_rotation():
    wide, narrow = (predict_mount_sigma(poses_turned_by(20, a, 0)).max() for a in (8, 2))
    assert narrow / wide == pytest.approx(4, rel=0.25)


def test_a_sensor_that_sees_only_open_mounts_floats_and_the_target_is_named():
    floating = find_floating_sensors({"left": {"board"}}, {"board": poses_turned_by(4, 0, 0)})
    assert floating["left"].reason.startswith("T_body_target of board is not determined")


def test_a_target_with_known_mount_holds_the_sensors_and_mounts_that_are_seen_together():
    open_mounts = {"board": poses_turned_by(4, 0, 0), "other": poses_turned_by(9, 0, 0)}
    seen = {"left": {"board", "cylinder"}, "right": {"board"}, "rear": {"other"}}
    assert set(find_floating_sensors(seen, open_mounts)) == {"rear"}


@pytest.mark.parametrize(("mount_sigma", "floating"), [({}, {"camera", "lidar"}), (STATED, set())])
def test_an_estimated_mount_with_a_stated_alignment_sigma_leaves_no_sensor_open(
    mount_sigma, floating
):
    setup = make_synthetic_setup(0, [("board", None)] * 8)
    upright = [
        replace(p, T_robot_body=T) for p, T in zip(setup.placements, ABOUT_ONE_AXIS, strict=True)
    ]
    setup = replace(
        setup, placements=upright, initial_mounts={"board": np.eye(4)}, mount_sigma=mount_sigma
    )
    assert set(find_floating_sensors_of_setup(setup)) == floating


def test_a_board_without_outline_is_a_board_in_the_advice_on_views():
    target = target_from_config(validate_and_complete("target", CHARUCO, "charuco"))
    directions = normals_and_axes([target] * 8, poses_turned_by(20, 20, 0))
    assert (len(directions["normals"]), len(directions["axes"])) == (8, 0)
    assert set(direction_spread_deg(directions)) == {"normals"}
