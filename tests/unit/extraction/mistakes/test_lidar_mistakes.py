"""Mistakes of convention that the scans of a lidar tell."""

from dataclasses import replace

import numpy as np
import pytest

from calib.extraction.mistakes.mistake_search import find_mistake
from calib.extraction.mistakes.pose_corrections import describe_pose
from calib.extraction.mistakes.sightings import LidarSightings
from calib.extraction.mistakes.stated_setup import StatedSetup
from calib.geometry.polygon import signed_polygon_distance
from calib.geometry.se3 import (
    invert_pose,
    make_pose,
    pose_from_rpy,
    pose_from_xyz_quat,
    pose_to_quat,
    so3_exp,
)
from calib.initial_guess import lidar_matching
from calib.initial_guess.lidar_matching import find_lidar_pose
from calib.sensors.lidar.clouds.cloud_messages import LidarPoints
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.board import Board
from calib.views.initial_guess_frames import FrameSample
from helpers.photographed_boards import GUESS_OPTIONS, GUESS_SIGMA

LIDAR = LidarModel(np.radians(0.4), np.radians(1.0), None, None, (0.3, 100.0), 0.01)
PLATE = Board(np.array([[0.6, 0.35], [-0.6, 0.35], [-0.6, -0.35], [0.6, -0.35]]), 0.0, None)
T_ROBOT_LIDAR = pose_from_rpy([0.42, -0.31, 0.83], np.radians([9.0, -17.0, 64.0]))
T_BODY_PLATE = pose_from_rpy([-0.11, 0.07, 0.15], np.radians([-31.0, 14.0, 75.0]))
R_FACING = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])  # z towards the lidar, which looks at +x


def scan_of(T_lidar_plate):
    """Returns (n, 3), m, of a plate with 5 mm noise, from a lidar with 1 degree between rings."""
    azimuth, elevation = np.radians(np.arange(-60, 60, 0.4)), np.radians(np.arange(-25, 26))
    a, e = (g.ravel() for g in np.meshgrid(azimuth, elevation))
    rays = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    n, p = T_lidar_plate[:3, 2], T_lidar_plate[:3, 3]
    ranges = (n @ p) / (rays @ n)
    points = ranges[:, None] * rays
    flat = (points - p) @ T_lidar_plate[:3, :2]
    on_plate = (ranges > 0) & (signed_polygon_distance(PLATE.vertices, flat) < 0)
    noise = 0.005 * np.random.default_rng(0).normal(size=on_plate.sum())
    return points[on_plate] + noise[:, None] * rays[on_plate]


def with_rolled_quaternion(T):
    """A pose whose quaternion w, x, y, z is read as x, y, z, w."""
    return pose_from_xyz_quat(T[:3, 3], np.roll(pose_to_quat(T), 1))


@pytest.fixture(scope="module")
def seen():
    """A right config of a lidar that sees a plate at nine places."""
    rng, poses = np.random.default_rng(2), []
    for _ in range(9):
        R = R_FACING @ so3_exp(rng.uniform(-0.6, 0.6, 3))
        poses.append(make_pose(R, [rng.uniform(2, 3), *rng.uniform(-0.7, 0.7, 2)]))
    T_robot_body = [T_ROBOT_LIDAR @ T @ invert_pose(T_BODY_PLATE) for T in poses]
    stated = StatedSetup(
        sensor="top",
        model=LIDAR,
        targets={"plate": PLATE},
        mounts={"plate": T_BODY_PLATE},
        T_robot_body=dict(enumerate(T_robot_body)),
        T_robot_sensor=T_ROBOT_LIDAR,
        sigma=GUESS_SIGMA,
    )
    samples = [FrameSample(k, "plate", k, T) for k, T in enumerate(T_robot_body)]
    scans = [scan_of(T) for T in poses]
    return stated, LidarSightings(samples, scans, stated, GUESS_OPTIONS)


def test_a_right_config_of_a_lidar_has_no_mistake(seen):
    assert find_mistake(*seen, 3) is None


def test_the_pose_of_a_lidar_is_found_in_scans_as_they_are_read(seen):
    """Scans as read_points returns them, with rings, times and intensities; within 2 cm."""
    stated, _ = seen
    samples = [FrameSample(k, "plate", k, T @ T_BODY_PLATE) for k, T in stated.T_robot_body.items()]

    def read_frame(k):
        xyz = scan_of(invert_pose(T_ROBOT_LIDAR) @ samples[k].T_robot_target)
        none = np.zeros(len(xyz))
        return LidarPoints(xyz.astype(np.float32), none - 1, none, none)

    found = find_lidar_pose(LIDAR, stated.targets, samples, read_frame, GUESS_OPTIONS)
    np.testing.assert_allclose(found.value[:3, 3], T_ROBOT_LIDAR[:3, 3], atol=0.02)


def test_poses_that_no_candidate_agrees_with_give_no_pose(seen, monkeypatch):
    stated, sightings = seen
    monkeypatch.setattr(lidar_matching, "score_pose", lambda *arguments: 0.0)
    assert sightings.agree(replace(stated, T_robot_sensor=None)).T_robot_sensor is None


def test_an_inverted_pose_of_a_lidar_is_named_with_the_pose_to_write(seen):
    stated, sightings = seen
    wrong = replace(stated, T_robot_sensor=invert_pose(T_ROBOT_LIDAR))
    status = find_mistake(wrong, sightings, 3)
    assert "T_robot_sensor of top" in status.reason and "but its inverse does" in status.reason
    assert status.remedy == f"Set sensors.top.T_robot_sensor to {describe_pose(T_ROBOT_LIDAR)}."
    assert status.found.startswith("a thing like the target agrees with that at ")


def test_a_lidar_in_another_robot_frame_is_named(seen):
    stated, sightings = seen
    turned = make_pose([[0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ T_ROBOT_LIDAR
    status = find_mistake(replace(stated, T_robot_sensor=turned), sightings, 3)
    assert "turned by -90 deg about the z axis of its parent" in status.reason


def test_an_inverted_mount_is_named_by_a_lidar(seen):
    stated, sightings = seen
    wrong = replace(stated, mounts={"plate": invert_pose(T_BODY_PLATE)})
    status = find_mistake(wrong, sightings, 3)
    assert "T_body_target of plate" in status.reason and "its inverse" in status.reason


@pytest.mark.slow
def test_without_a_stated_pose_a_lidar_tells_the_order_of_quaternions(seen):
    """The motion capture's quaternions are read in the wrong order; the right one is the other."""
    stated, sightings = seen
    unposed = replace(stated, T_robot_sensor=None)
    assert find_mistake(unposed, sightings, 3) is None
    read_wrongly = {k: with_rolled_quaternion(T) for k, T in stated.T_robot_body.items()}
    wrong = replace(unposed, T_robot_body=read_wrongly, other_quaternions=stated.T_robot_body)
    status = find_mistake(wrong, sightings, 3)
    assert status.remedy == "Set mocap.quaternions of the rig to wxyz."
