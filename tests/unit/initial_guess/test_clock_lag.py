"""Coarse offsets of clocks from when what a sensor sees changes."""

import numpy as np
import pytest

from calib.geometry.se3 import pose_from_rpy
from calib.geometry.units import NS_PER_S
from calib.initial_guess.clock_lag import find_clock_lag, measure_motion
from calib.io.status import MessageError
from calib.mocap.body_trajectory import Trajectory
from calib.sensors.lidar.clouds.cloud_messages import LidarPoints

STATED = {"value": 0.0, "sigma": 0.05}
RNG = np.random.default_rng(0)
TEXTURE = RNG.integers(0, 255, (48, 200, 3), dtype=np.uint8)
WALL = RNG.uniform(-1, 1, (3000, 3)) * [0.3, 2, 2] + [3, 0, 0]


def path(seed, seconds=40):
    """A body that rests for some 1.2 s, then moves for 0.8 s by 0.1 to 0.4 m, at 100 Hz."""
    rng, t = np.random.default_rng(seed), np.arange(seconds * 100) / 100
    x, at, where = np.zeros(len(t)), 0.0, 0.0
    while at < seconds:
        begin = at + rng.uniform(0.8, 1.6)
        goal = where + rng.uniform(0.1, 0.4) * rng.choice([-1, 1])
        share = np.clip((t - begin) / 0.8, 0, 1)
        moving = t >= begin
        x[moving] = where + (goal - where) * (3 * share**2 - 2 * share**3)[moving]
        at, where = begin + 0.8, goal
    T = np.tile(np.eye(4), (len(t), 1, 1))
    T[:, 0, 3] = x
    return Trajectory((t * NS_PER_S).astype(np.int64), T, NS_PER_S // 20)


def image(x, rng):
    """What a camera that has moved by x, m, sees of the texture, with noise."""
    columns = (np.arange(64) + round(40 * x)) % 200
    return np.clip(TEXTURE[:, columns] + rng.normal(0, 3, (48, 64, 3)), 0, 255).astype(np.uint8)


def scan(x, rng):
    """What a lidar that has moved by x, m, towards a wall sees of it over 100 ms."""
    xyz = WALL + rng.normal(0, 0.01, WALL.shape) - [x, 0, 0]
    dt = np.linspace(0, 1e8, len(xyz)).astype(np.int64)
    return LidarPoints(xyz, np.zeros(len(xyz), int), dt, np.full(len(xyz), np.nan))


def found(kind, late, hz=10, body=None, broken=(), stated=STATED):
    """The Lag of a sensor whose stamps are early by `late`, s."""
    body, rng = body or path(1), np.random.default_rng(5)
    seen = np.arange(3, 37, 1 / hz)
    middle = 0.05 if kind == "lidar" else 0.0
    x = np.interp(seen + middle, body.stamps_ns / NS_PER_S, body.poses[:, 0, 3])

    def content_of(i):
        if i in broken:
            raise MessageError("damaged")
        return (image if kind == "camera" else scan)(x[i], rng)

    stamps = np.round((seen - late) * NS_PER_S).astype(np.int64)
    return find_clock_lag(kind, stamps, content_of, [body], stated)


@pytest.mark.parametrize("late", [-1.0, -0.4, 0.3, 0.7, 1.1])
@pytest.mark.parametrize("kind", ["camera", "lidar"])
def test_an_offset_of_up_to_a_second_is_found_to_40_ms(kind, late):
    told = found(kind, late)
    assert abs(told.value - late) < min(0.04, 3 * told.sigma)
    assert told.sigma < 0.1


def test_a_camera_of_2_hz_tells_it_to_a_fifth_of_a_second():
    told = found("camera", 0.8, hz=2)
    assert abs(told.value - 0.8) < min(0.2, 3 * told.sigma)


@pytest.mark.parametrize("late", [0.0, 0.05, 0.1])
def test_what_the_stated_offset_allows_is_left_to_the_solve(late):
    assert found("camera", late).value is None


def test_an_offset_beside_a_stated_one_is_found():
    told = found("camera", 0.7, stated={"value": 0.5, "sigma": 0.02})
    assert abs(told.value - 0.7) < 0.04
    assert found("camera", 0.7, stated={"value": 0.68, "sigma": 0.02}).value is None


def test_where_nothing_moves_nothing_is_told():
    still = path(1)
    T = np.tile(np.eye(4), (len(still.stamps_ns), 1, 1))
    T[:, :3, 3] += np.random.default_rng(2).normal(0, 1e-4, (len(T), 3))
    assert found("camera", 0.5, body=Trajectory(still.stamps_ns, T, still.max_gap_ns)).value is None


def test_moves_that_the_sensor_did_not_see_tell_nothing():
    body, other = path(1), path(9)
    rng, seen = np.random.default_rng(5), np.arange(3, 37, 0.1)
    x = np.interp(seen, other.stamps_ns / NS_PER_S, other.poses[:, 0, 3])
    stamps = np.round(seen * NS_PER_S).astype(np.int64)
    assert (
        find_clock_lag("camera", stamps, lambda i: image(x[i], rng), [body], STATED).value is None
    )


def test_frames_that_cannot_be_read_are_passed_over():
    told = found("camera", 0.7, broken=range(40, 340, 7))
    assert abs(told.value - 0.7) < 0.04


def test_motion_is_that_of_the_poses_and_unknown_in_gaps():
    T = np.tile(np.eye(4), (3, 1, 1))
    T[1, 0, 3], T[2] = 0.1, pose_from_rpy([0.1, 0, 0], [0, 0, 0.2])
    t = np.array([0, 10_000_000, 20_000_000])
    times = np.array([[0, 10_000_000], [10_000_000, 20_000_000], [0, 30_000_000]])
    moved = measure_motion(Trajectory(t, T, NS_PER_S // 20), times)
    np.testing.assert_allclose(moved[:2], [0.1, 0.2], atol=1e-9)
    assert np.isnan(moved[2])
