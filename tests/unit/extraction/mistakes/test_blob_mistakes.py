"""Mistakes of convention that a camera tells which sees coloured bodies only."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.extraction.mistakes.mistake_search import find_mistake
from calib.extraction.mistakes.sightings import BlobSightings
from calib.extraction.mistakes.stated_setup import StatedSetup
from calib.geometry.se3 import (
    invert_pose,
    make_pose,
    pose_from_rpy,
    se3_log,
    so3_exp,
    transform_points,
)
from calib.initial_guess.camera_from_blobs import BlobView, blob_features
from calib.targets.cylinder import Cylinder
from calib.views.initial_guess_frames import FrameSample
from helpers.photographed_boards import GUESS_OPTIONS, GUESS_SIGMA, LENS, T_ROBOT_CAMERA

PIPE = Cylinder(0.5, 0.06)
T_BODY_PIPE = pose_from_rpy([0.21, -0.13, 0.32], np.radians([18.0, -40.0, 65.0]))
N_PLACES = 10


@pytest.fixture(scope="module")
def seen():
    """A right config of a camera that sees a pipe at ten places."""
    rng, poses = np.random.default_rng(3), []
    for _ in range(N_PLACES):
        place = [*rng.uniform(-0.5, 0.5, 2), rng.uniform(1.6, 2.6)]
        poses.append(make_pose(so3_exp(rng.uniform(-1, 1, 3)), place))
    T_robot_body = [T_ROBOT_CAMERA @ T @ invert_pose(T_BODY_PIPE) for T in poses]
    stated = StatedSetup(
        sensor="side",
        model=LENS,
        targets={"pipe": PIPE},
        mounts={"pipe": T_BODY_PIPE},
        T_robot_body=dict(enumerate(T_robot_body)),
        T_robot_sensor=T_ROBOT_CAMERA,
        sigma=GUESS_SIGMA,
        images=(np.zeros(LENS.size_px[::-1], np.uint8),),
    )
    blobs = []
    for k, T in enumerate(poses):
        uv, _ = LENS.project(transform_points(T, PIPE.outline_points()))
        hull = cv2.convexHull(uv.astype(np.float32), returnPoints=False)[:, 0]
        sample = FrameSample(k, "pipe", k, T_robot_body[k])
        blobs.append(BlobView(sample, blob_features(uv[hull])))
    return stated, BlobSightings(blobs, GUESS_OPTIONS)


def test_a_right_config_of_a_camera_that_sees_a_pipe_has_no_mistake(seen):
    assert find_mistake(*seen, 3) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (invert_pose(T_ROBOT_CAMERA), "but its inverse does"),
        (T_ROBOT_CAMERA @ make_pose([[0, -1, 0], [0, 0, -1], [1, 0, 0]]), "in optical axes"),
    ],
    ids=["inverted", "body axes"],
)
def test_a_pose_in_another_convention_is_named_by_the_pipe_alone(seen, wrong, words):
    stated, sightings = seen
    status = find_mistake(replace(stated, T_robot_sensor=wrong), sightings, 3)
    assert "T_robot_sensor of side" in status.reason and words in status.reason
    assert status.found.startswith("the coloured body agrees with that at ")


@pytest.mark.slow
def test_an_inverted_mount_is_named_by_the_pipe_alone(seen):
    stated, sightings = seen
    wrong = replace(stated, mounts={"pipe": invert_pose(T_BODY_PIPE)})
    status = find_mistake(wrong, sightings, 3)
    assert "T_body_target of pipe" in status.reason and "its inverse" in status.reason


@pytest.mark.slow
def test_without_a_stated_pose_the_pipe_tells_it(seen):
    """The right pose to 1 mm and 0.1 degrees, at all places."""
    stated, sightings = seen
    found = sightings.agree(replace(stated, T_robot_sensor=None))
    assert found.n_agreeing == found.n_found == N_PLACES
    off = se3_log(invert_pose(T_ROBOT_CAMERA) @ found.T_robot_sensor)
    assert np.abs(off[:3]).max() < 1e-3 and np.abs(off[3:]).max() < np.radians(0.1)
