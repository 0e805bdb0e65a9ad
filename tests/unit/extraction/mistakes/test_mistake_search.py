"""Mistakes of convention in the config are named with what to write, and right configs are not."""

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.extraction.mistakes.lens_resolution import scale_lens
from calib.extraction.mistakes.mistake_search import find_mistake
from calib.extraction.mistakes.pose_corrections import describe_pose
from calib.extraction.mistakes.swapped_axes import R_BODY_OPTICAL, axis_rotations
from calib.geometry.se3 import (
    invert_pose,
    make_pose,
    pose_from_rpy,
    pose_from_xyz_quat,
    pose_to_quat,
    se3_exp,
)
from helpers.photographed_boards import (
    GUESS_SIGMA,
    LENS,
    PATTERN,
    T_BODY_BOARD,
    T_ROBOT_CAMERA,
    make_board,
    true_setup,
)

MIN_PLACEMENTS = 3
OFF_BY_A_SIGMA = se3_exp(GUESS_SIGMA * [1, -1, 0.5, 0.7, -1, 0.9])


@pytest.fixture(scope="module")
def seen():
    """A right config of a camera that sees a board at eight places."""
    return true_setup()


def named(stated, sightings):
    """Reason and remedy of the mistake that is named."""
    status = find_mistake(stated, sightings, MIN_PLACEMENTS)
    assert status is not None and not status.ok
    assert re.fullmatch(r"the pattern agrees with that at \d of 8 placements", status.found)
    return status.reason, status.remedy


def test_a_right_config_has_no_mistake_however_the_guess_is_off_by_its_sigma(seen):
    stated, sightings = seen
    off = replace(stated, T_robot_sensor=T_ROBOT_CAMERA @ OFF_BY_A_SIGMA)
    assert find_mistake(stated, sightings, MIN_PLACEMENTS) is None
    assert find_mistake(off, sightings, MIN_PLACEMENTS) is None
    assert find_mistake(replace(stated, T_robot_sensor=None), sightings, MIN_PLACEMENTS) is None


def rolled(T, shift):
    return pose_from_xyz_quat(T[:3, 3], np.roll(pose_to_quat(T), shift))


def negated(T, signs):
    R = T[:3, :3]
    return make_pose(R, T[:3, 3] * signs)


SENSOR_MISTAKES = {
    "its inverse": invert_pose,
    "the same position with the inverse rotation": lambda T: make_pose(T[:3, :3].T, T[:3, 3]),
    "the same in optical axes": lambda T: T @ make_pose(R_BODY_OPTICAL.T),
    "the same in body axes": lambda T: T @ make_pose(R_BODY_OPTICAL),
    "by 90 deg about the z axis of its parent": lambda T: (
        make_pose([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) @ T
    ),
    "by 180 deg about the z axis of its own": lambda T: T @ make_pose(np.diag([-1.0, -1, 1])),
    "its quaternion read as w, x, y, z": lambda T: rolled(T, 1),
    "the same with y negated": lambda T: negated(T, [1, -1, 1]),
    "xyz_m read in millimetres": lambda T: negated(T, [1000, 1000, 1000]),
}


@pytest.mark.parametrize("words", SENSOR_MISTAKES)
def test_a_mistake_in_the_sensor_s_pose_is_named_with_the_pose_to_write(seen, words):
    stated, sightings = seen
    meant = T_ROBOT_CAMERA @ OFF_BY_A_SIGMA
    wrong = replace(stated, T_robot_sensor=SENSOR_MISTAKES[words](meant))
    reason, remedy = named(wrong, sightings)
    assert reason.startswith("T_robot_sensor of left does not agree with what left saw, but ")
    assert words in reason
    assert remedy == f"Set sensors.left.T_robot_sensor to {describe_pose(meant)}."


def test_the_pose_to_write_is_told_to_programs_too(seen):
    stated, sightings = seen
    meant = T_ROBOT_CAMERA @ OFF_BY_A_SIGMA
    wrong = replace(stated, T_robot_sensor=invert_pose(meant))
    status = find_mistake(wrong, sightings, MIN_PLACEMENTS)
    assert status.change["file"] == "config/rigs/{rig}.yaml"
    assert status.change["key"] == "sensors.left.T_robot_sensor"
    value = status.change["value"]
    found = pose_from_rpy(value["xyz_m"], np.radians(value["rpy_deg"]))
    np.testing.assert_allclose(found, meant, atol=1e-6)


def test_the_params_of_a_lens_of_half_the_resolution_are_told_to_programs_too(seen):
    stated, sightings = seen
    wrong = replace(stated, model=scale_lens(LENS, 0.5))
    status = find_mistake(wrong, sightings, MIN_PLACEMENTS)
    assert (status.change["file"], status.change["key"]) == (
        "config/rigs/{rig}.yaml",
        "sensors.left.params",
    )
    np.testing.assert_allclose(status.change["value"][:4], LENS.params[:4], rtol=1e-6)


BOARD_MISTAKES = {
    "its inverse": invert_pose,
    "by 180 deg about the x axis of its own": lambda T: T @ make_pose(np.diag([1.0, -1, -1])),
    "its quaternion read as w, x, y, z": lambda T: rolled(T, -1),
}


@pytest.mark.parametrize("words", BOARD_MISTAKES)
def test_a_mistake_in_a_board_s_mount_is_named_with_the_mount_to_write(seen, words):
    stated, sightings = seen
    wrong = replace(stated, mounts={"plate": BOARD_MISTAKES[words](T_BODY_BOARD)})
    reason, remedy = named(wrong, sightings)
    assert "T_body_target of plate does not agree with what left saw" in reason
    assert words in reason or "by 180 deg about the y axis" in reason
    written = [float(x) for x in re.findall(r"-?\d+\.\d+", remedy)]
    found = pose_from_rpy(written[:3], np.radians(written[3:]))
    flat = found[:3, 2] @ T_BODY_BOARD[:3, 2]
    assert flat > 0.999 and np.abs(found[:3, 3] - T_BODY_BOARD[:3, 3]).max() < 1e-3


def test_a_pose_that_no_rule_explains_is_given_as_the_data_have_it(seen):
    stated, sightings = seen
    turn = pose_from_rpy([0.4, -0.3, 0.2], np.radians([38, -41, 29]))
    reason, remedy = named(replace(stated, T_robot_sensor=T_ROBOT_CAMERA @ turn), sightings)
    assert re.search(r"but a pose 0\.5\d m and \d\d deg away does", reason)
    x = float(re.search(r"xyz_m: \[(.*?),", remedy)[1])
    assert abs(x - T_ROBOT_CAMERA[0, 3]) < 0.01 and "or leave it out" in remedy


@pytest.mark.parametrize("has_pose", [True, False])
@pytest.mark.parametrize("first", [(-0.11, -0.14), (-0.14, -0.11)])
def test_rows_and_columns_exchanged_are_named_with_the_counts_to_write(seen, first, has_pose):
    stated, sightings = seen
    swapped = replace(PATTERN, n_columns=4, n_rows=7, first_corner=first, first_square_color=None)
    wrong = replace(stated, targets={"plate": make_board(swapped)})
    wrong = wrong if has_pose else replace(wrong, T_robot_sensor=None)
    reason, remedy = named(wrong, sightings)
    assert reason == (
        "the images of left show the pattern of plate with 7 x 4 inner corners along x and y, the "
        "config states 4 x 7"
    )
    corner = " and first_corner_m to [-0.14, -0.11]" if first[0] == -0.11 else ""
    assert remedy == f"Set pattern.inner_corners of plate to [7, 4]{corner}."


def test_another_number_of_corners_is_named_with_the_number_to_write(seen):
    stated, sightings = seen
    smaller = replace(PATTERN, n_columns=6, n_rows=3, first_square_color=None)
    reason, remedy = named(replace(stated, targets={"plate": make_board(smaller)}), sightings)
    assert "7 x 4 inner corners along x and y, the config states 6 x 3" in reason
    assert remedy == "Set pattern.inner_corners of plate to [7, 4]."


def test_the_other_colour_first_is_named_as_a_pattern_read_the_other_way_round(seen):
    stated, sightings = seen
    white = make_board(replace(PATTERN, first_square_color="white"))
    reason, remedy = named(replace(stated, targets={"plate": white}), sightings)
    assert reason == "left sees the pattern of plate the other way round than configured"
    assert remedy.startswith("Set first_square of plate to black.")


@pytest.mark.parametrize(
    ("axis", "direction"), [(1, "left to right"), (0, "top to bottom")], ids=str
)
@pytest.mark.parametrize("color", ["black", None])
def test_mirrored_images_of_a_checkerboard_are_named_and_nothing_else(axis, direction, color):
    stated, sightings = true_setup(replace(PATTERN, first_square_color=color))
    flipped = tuple(np.ascontiguousarray(np.flip(image, axis)) for image in stated.images)
    reason, remedy = named(replace(stated, images=flipped), sightings)
    assert reason == f"the images of left are mirrored {direction}"
    assert remedy.startswith("Switch off the mirror image (flip) in the driver of left")


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_lens_of_another_binning_is_named_with_the_params_of_the_images(seen, factor):
    stated, sightings = seen
    binned = replace(scale_lens(LENS, factor), size_px=LENS.size_px)
    reason, remedy = named(replace(stated, model=binned), sightings)
    assert "the lens of left is of another resolution than its images" in reason
    assert remedy == "Set params to [420, 420, 315, 245, 0, 0, 0, 0] of sensors.left."


def test_a_lens_and_size_of_larger_images_are_named_with_both_to_write(seen):
    stated, sightings = seen
    large = replace(scale_lens(LENS, 2), size_px=(1280, 960))
    _, remedy = named(replace(stated, model=large), sightings)
    assert remedy == (
        "Set size_px to [640, 480] and params to [420, 420, 315, 245, 0, 0, 0, 0] of sensors.left."
    )
    only_size = replace(LENS, size_px=(1280, 960))
    _, remedy = named(replace(stated, model=only_size), sightings)
    assert remedy == "Set size_px to [640, 480] of sensors.left."


def test_quaternions_of_the_motion_capture_in_the_other_order_are_named_with_the_key(seen):
    stated, sightings = seen
    right = stated.T_robot_body
    wrong = {k: rolled(T, 1) for k, T in right.items()}
    stated = replace(stated, T_robot_body=wrong, other_quaternions=right, other_order="wxyz")
    reason, remedy = named(stated, sightings)
    assert "only if its quaternions are read as w, x, y, z" in reason
    assert remedy == "Set mocap.quaternions of the rig to wxyz."


def test_images_that_fit_nothing_are_not_explained(seen):
    stated, sightings = seen
    rng = np.random.default_rng(1)
    places = {k: se3_exp(rng.normal(size=6)) for k in stated.T_robot_body}
    assert find_mistake(replace(stated, T_robot_body=places), sightings, MIN_PLACEMENTS) is None


def test_the_rotations_that_exchange_axes_are_the_23_of_a_cube():
    rotations = axis_rotations()
    assert len({tuple(R.ravel()) for R in rotations}) == 23
    assert all(np.linalg.det(R) == pytest.approx(1) for R in rotations)
