"""Motion capture: poses between samples, faults, speeds, stillness; made and recorded streams."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.geometry.se3 import (
    interpolate_poses,
    invert_pose,
    make_pose,
    pose_from_xyz_quat,
    se3_exp,
    so3_exp,
)
from calib.geometry.units import NS_PER_S
from calib.mocap.body_trajectory import (
    Trajectory,
    longest_gap_ns,
    relative_trajectory,
    trajectory_from_columns,
)
from calib.mocap.pose_faults import flag_poses
from calib.mocap.stillness import (
    StillnessLimits,
    count_effective_samples,
    find_still_intervals,
    trajectory_speeds,
)
from helpers.real_data import find_shared_data

MS = 1_000_000
GAP = 50 * MS
WINDOW_S, MAX_LINEAR, MAX_ANGULAR = 0.3, 0.01, np.radians(0.75)
REST, ORIGIN = np.zeros(6), np.eye(4)
NOISE = np.repeat([0.0002, np.radians(0.02)], 3)


def clock(seconds, hz=200):
    """Stamps, ns, over so many seconds."""
    return np.arange(round(seconds * hz) + 1) * (NS_PER_S // hz)


def moving(t, xi=REST, start=ORIGIN):
    """Trajectory of a body with the constant twist xi, m/s and rad/s."""
    return Trajectory(t, start @ se3_exp(t[:, None] / NS_PER_S * xi), GAP)


def noisy(trajectory, seed=0, sigma=NOISE):
    xi = np.random.default_rng(seed).normal(size=(len(trajectory.stamps_ns), 6)) * sigma
    return Trajectory(trajectory.stamps_ns, trajectory.poses @ se3_exp(xi), trajectory.max_gap_ns)


def still(trajectory, trim_s=0.1, min_duration_s=0.3, max_rest_gap_s=0.5):
    """Still intervals, s, with the limits of the default config."""
    limits = StillnessLimits(
        window_s=WINDOW_S,
        max_linear_mps=MAX_LINEAR,
        max_angular_radps=MAX_ANGULAR,
        trim_s=trim_s,
        min_duration_s=min_duration_s,
        max_rest_gap_s=max_rest_gap_s,
    )
    spans = find_still_intervals(trajectory, limits)
    return spans / NS_PER_S


# --- poses between samples

POSES = se3_exp(
    np.array(
        [[0, 0, 0, 0, 0, 0], [1, 2, 3, 0.1, 0.2, -0.3], [1, 2, 4, 3, 0, 0.1], [0, 0, 1, 0, 2, 0]]
    )
)
SAMPLES = Trajectory(np.array([0, 10, 20, 100]) * MS, POSES, GAP)


def test_a_pose_at_a_sample_is_that_sample_also_beside_a_gap():
    T, known = SAMPLES.poses_at(SAMPLES.stamps_ns)
    assert known.all()
    assert np.abs(T - POSES).max() < 1e-14


def test_a_pose_between_samples_lies_on_the_geodesic_in_proportion_to_time():
    T, known = SAMPLES.poses_at([4 * MS, 12 * MS])
    assert known.all()
    assert T[0] == pytest.approx(interpolate_poses(POSES[0], POSES[1], 0.4), abs=1e-14)
    assert T[1] == pytest.approx(interpolate_poses(POSES[1], POSES[2], 0.2), abs=1e-14)


@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6), st.integers(0, NS_PER_S))
@settings(max_examples=40, deadline=None)
def test_a_body_of_constant_twist_is_known_exactly_at_any_time(xi, t):
    T, known = moving(clock(1, 40), np.array(xi)).poses_at([t])
    assert known[0]
    assert T[0] == pytest.approx(se3_exp(t / NS_PER_S * np.array(xi)), abs=1e-12)


def test_nothing_is_known_in_a_gap_before_the_first_and_after_the_last_sample():
    t = np.array([-1, 20 * MS + 1, 60 * MS, 100 * MS - 1, 100 * MS + 1, -(2**62), 2**62])
    T, known = SAMPLES.poses_at(t)
    assert not known.any()
    assert np.array_equal(T, np.tile(ORIGIN, (len(t), 1, 1)))


def test_a_gap_of_exactly_max_gap_is_bridged_and_one_of_a_nanosecond_more_is_not():
    t, T = np.array([0, GAP]), POSES[:2]
    assert Trajectory(t, T, GAP).poses_at([GAP // 2])[1].all()
    assert not Trajectory(t, T, GAP - 1).poses_at([GAP // 2])[1].any()


def test_a_trajectory_without_a_sample_knows_nothing():
    T, known = Trajectory(np.zeros(0, np.int64), np.zeros((0, 4, 4)), GAP).poses_at([0, 5])
    assert T.shape == (2, 4, 4) and not known.any()


def test_a_trajectory_of_one_sample_knows_that_instant_alone():
    one = Trajectory(np.array([7]), POSES[1:2], GAP)
    T, known = one.poses_at([6, 7, 8])
    assert known.tolist() == [False, True, False]
    assert T[1] == pytest.approx(POSES[1], abs=1e-14)


def test_no_times_give_no_poses():
    T, known = SAMPLES.poses_at(np.zeros(0, np.int64))
    assert T.shape == (0, 4, 4) and known.shape == (0,)


def test_stamps_of_this_century_lose_no_nanosecond():
    late = Trajectory(SAMPLES.stamps_ns + 1_760_000_000 * NS_PER_S, POSES, GAP)
    T, known = late.poses_at(np.array([1_760_000_000 * NS_PER_S + 4 * MS]))
    assert known[0] and T[0] == pytest.approx(SAMPLES.poses_at([4 * MS])[0][0], abs=1e-12)


def test_a_relative_trajectory_is_the_target_seen_from_the_robot_where_both_are_known():
    robot = moving(clock(1, 100), np.array([0.2, 0, 0, 0, 0, 0.5]))
    t = np.array([-5, 3, 500, 990, 1001, 2000]) * MS
    target = moving(t, np.array([0, 0.1, 0, 0.3, 0, 0]), make_pose(t=[3, 0, 0]))
    relative = relative_trajectory(robot, target)
    assert (relative.stamps_ns == t[1:4]).all()
    expected = invert_pose(robot.poses_at(t[1:4])[0]) @ target.poses[1:4]
    assert np.abs(relative.poses - expected).max() < 1e-14


# --- faults


def healthy(n=6):
    """Stamps, positions and quaternions of a body that is tracked well, at 1 m/s."""
    q = np.tile([0.0, 0.0, 0.6, 0.8], (n, 1))
    return np.arange(n) * MS, np.column_stack([1 + np.arange(n) / 1e3, np.ones(n), np.ones(n)]), q


def test_a_healthy_stream_has_no_fault():
    assert (flag_poses(*healthy()) == "").all()


def test_a_stream_without_a_pose_has_no_fault():
    assert flag_poses(*healthy(0)).shape == (0,)


@pytest.mark.parametrize("quat", [[0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, -1]])
def test_a_body_that_drops_to_the_origin_was_lost(quat):
    t, xyz, q = healthy()
    xyz[2], q[2] = 0, quat
    assert flag_poses(t, xyz, q).tolist() == ["", "", "zeros", "", "", ""]


def test_a_body_at_the_origin_all_the_time_is_a_choice_of_frames():
    t, xyz, q = healthy()
    xyz[:], q[:] = 0, [0, 0, 0, 1]
    assert (flag_poses(t, xyz, q) == "").all()


def test_a_body_that_turns_at_the_origin_is_tracked():
    t, xyz, q = healthy()
    xyz -= xyz[2]
    assert (flag_poses(t, xyz, q) == "").all()


def test_zeros_all_the_time_are_no_pose():
    t, xyz, q = healthy()
    xyz[:], q[:] = 0, 0
    assert (flag_poses(t, xyz, q) == "quaternion not unit").all()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("column", [0, 4])
def test_what_is_not_a_finite_number_is_a_fault(bad, column):
    t, xyz, q = healthy()
    values = np.hstack([xyz, q])
    values[3, column] = bad
    with np.errstate(invalid="ignore"):
        found = flag_poses(t, values[:, :3], values[:, 3:])
    assert found.tolist() == ["", "", "", "not a number", "", ""]


@pytest.mark.parametrize(
    "length, fault", [(0.98, True), (1.02, True), (0.995, False), (1.005, False)]
)
def test_a_quaternion_may_be_off_unit_by_a_hundredth(length, fault):
    t, xyz, q = healthy()
    q[1] *= length
    assert flag_poses(t, xyz, q)[1] == ("quaternion not unit" if fault else "")


def test_stamps_that_stand_or_go_back_are_faults_until_time_goes_on():
    _, xyz, q = healthy()
    t = np.array([0, 10, 10, 5, 9, 20])
    bad = "stamp not increasing"
    assert flag_poses(t, xyz, q).tolist() == ["", "", bad, bad, bad, ""]


def test_a_trajectory_is_made_of_the_healthy_poses_of_its_body():
    t, xyz, q = healthy()
    fault = np.array(["", "zeros", "", "", "", ""])
    body = np.array(["robot", "robot", "robot", "board", "robot", "board"])
    columns = dict(body=body, stamp_ns=t, xyz=xyz, quat=q, fault=fault)
    robot = trajectory_from_columns(columns, "robot", 0.05)
    assert (robot.stamps_ns == t[[0, 2, 4]]).all() and robot.max_gap_ns == GAP
    assert robot.poses[1] == pytest.approx(pose_from_xyz_quat(xyz[2], q[2]))
    assert len(trajectory_from_columns(columns, "nobody", 0.05).stamps_ns) == 0


# --- speeds


@pytest.mark.parametrize("hz", [30, 100, 300])
def test_a_constant_velocity_is_recovered_exactly(hz):
    linear, angular = trajectory_speeds(
        moving(clock(2, hz), np.array([0.3, -0.4, 0, 0, 0, 0])), WINDOW_S
    )
    inside = np.isfinite(linear)
    assert inside.sum() > hz
    assert linear[inside] == pytest.approx(np.full(inside.sum(), 0.5), abs=1e-9)
    assert angular[inside] == pytest.approx(np.zeros(inside.sum()), abs=1e-9)


@pytest.mark.parametrize("rate", [0.01, 1.0, 20.0])
def test_a_constant_turning_rate_is_recovered_exactly_through_any_number_of_turns(rate):
    spin = rate * np.array([2, -3, 6]) / 7
    linear, angular = trajectory_speeds(moving(clock(3), np.append([0, 0, 0], spin)), WINDOW_S)
    inside = np.isfinite(angular)
    assert angular[inside] == pytest.approx(np.full(inside.sum(), rate), rel=1e-9)
    assert linear[inside] == pytest.approx(np.zeros(inside.sum()), abs=1e-9)


def test_a_speed_is_right_at_the_end_of_a_log_of_an_hour():
    """Sums over all samples must not swallow the window's own."""
    t = clock(3600, 200)
    T = make_pose(t=np.column_stack([5 + 1e-3 * t / NS_PER_S, 0 * t, 0 * t]))
    linear, _ = trajectory_speeds(Trajectory(t, T, GAP), WINDOW_S)
    assert linear[-200:-100] == pytest.approx(np.full(100, 1e-3), abs=1e-4)


def test_noise_is_averaged_over_the_window():
    """61 samples in 0.3 s: a slope scatters by σ √12 / (0.3 s √61) = 0.3 mm/s per axis."""
    linear, angular = trajectory_speeds(noisy(moving(clock(20))), WINDOW_S)
    inside = np.isfinite(linear)
    differences = 0.0002 * np.sqrt(2) * 200
    assert np.sqrt(np.mean(linear[inside] ** 2)) < 0.002 < differences / 25
    assert linear[inside].max() < 0.004
    assert np.sqrt(np.mean(angular[inside] ** 2)) < np.radians(0.2)


def test_speeds_are_infinite_where_half_a_window_is_not_covered():
    t = clock(2, 100)
    t = t[(t < 800 * MS) | (t > 1000 * MS)]
    linear, angular = trajectory_speeds(moving(t), WINDOW_S)
    for speed in (linear, angular):
        covered = np.isfinite(speed)
        assert t[covered].min() == 150 * MS and t[covered].max() == 1850 * MS
        assert not covered[(t > 640 * MS) & (t < 1160 * MS)].any()
        assert covered[(t >= 150 * MS) & (t <= 640 * MS)].all()


@pytest.mark.parametrize("gap_ms", [60, 200, 5000])
def test_speeds_are_infinite_beside_gaps_shorter_and_longer_than_the_window(gap_ms):
    t = clock(1, 100)
    t = np.concatenate([t, t + t[-1] + gap_ms * MS])
    finite = t[np.isfinite(trajectory_speeds(moving(t), WINDOW_S)[0])]
    edge = NS_PER_S
    assert finite[finite < edge].max() == edge - 150 * MS
    assert finite[finite > edge].min() == edge + gap_ms * MS + 150 * MS


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_samples_have_no_speed(n):
    linear, angular = trajectory_speeds(moving(clock(1)[:n]), WINDOW_S)
    assert linear.shape == angular.shape == (n,)
    assert np.isinf(linear).all() and np.isinf(angular).all()


# --- stillness


def test_a_body_that_does_not_move_is_still_but_for_half_a_window_and_the_trim_at_both_ends():
    assert still(moving(clock(5))) == pytest.approx(np.array([[0.25, 4.75]]))


def test_a_still_body_is_still_under_the_noise_of_the_motion_capture():
    assert still(noisy(moving(clock(60)))) == pytest.approx(np.array([[0.25, 59.75]]))


def test_a_pure_rotation_in_place_is_motion():
    spin = np.array([0, 0, 0, 0, 0, np.radians(2)])
    assert len(still(moving(clock(5), spin))) == 0
    assert len(still(moving(clock(5), 0.1 * spin))) == 1


def test_a_pure_translation_is_motion():
    shift = np.array([0, 0.02, 0, 0, 0, 0])
    assert len(still(moving(clock(5), shift))) == 0
    assert len(still(moving(clock(5), 0.1 * shift))) == 1


@pytest.mark.parametrize("hz", [1, 2, 3.33, 4.77, 6, 8.2, 10])
def test_an_oscillation_within_the_window_is_motion(hz):
    """A hand's tremor, 5 mm: the slope over 0.3 s vanishes all the time at 4.77 and 8.2 Hz."""
    t = clock(5)
    swing = np.sin(2 * np.pi * hz * t / NS_PER_S)
    shaken = make_pose(t=0.005 * swing[:, None] * [0.6, 0.8, 0])
    assert len(still(Trajectory(t, shaken, GAP))) == 0
    nodding = make_pose(so3_exp(np.radians(1) * swing[:, None] * [0, 0.6, 0.8]))
    assert len(still(Trajectory(t, nodding, GAP))) == 0


def stops(seconds_still, gap_s=0.0, step=0.5):
    """Trajectory that is still, moves by step, m, within 1 s (or unseen in a gap), and is still."""
    t = clock(2 * seconds_still + 1, 100)
    s = np.clip(t / NS_PER_S - seconds_still, 0, 1)
    T = make_pose(t=(step * (3 * s**2 - 2 * s**3))[:, None] * [1, 0, 0])
    seen = np.abs(t / NS_PER_S - seconds_still - 0.5) >= gap_s / 2
    return Trajectory(t[seen], T[seen], GAP)


def test_stillness_ends_where_motion_begins():
    spans = still(stops(3.0))
    assert spans.shape == (2, 2)
    assert 2.6 < spans[0, 1] < 3.0 and 4.0 < spans[1, 0] < 4.4


def test_a_move_in_a_gap_of_the_motion_capture_parts_two_placements():
    spans = still(stops(3.0, gap_s=1.0))
    assert spans == pytest.approx(np.array([[0.25, 2.75], [4.25, 6.75]]), abs=0.011)


def test_a_rest_spans_a_short_gap_with_the_same_pose_on_both_sides():
    assert len(still(stops(3.0, gap_s=0.2, step=0.0))) == 1
    assert len(still(stops(3.0, gap_s=0.7, step=0.0))) == 2
    assert len(still(stops(3.0, gap_s=0.2, step=0.0), max_rest_gap_s=0.1)) == 2


def test_a_rest_does_not_span_a_gap_in_which_a_body_moved_by_4_mm():
    before = stops(3.0, gap_s=0.2, step=0.0)
    moved = before.poses.copy()
    moved[before.stamps_ns > 3.5 * NS_PER_S, 0, 3] += 0.004
    assert len(still(Trajectory(before.stamps_ns, moved, GAP))) == 2


def test_a_rest_is_found_through_588_gaps_of_up_to_0_1_s():
    """30 s at rest, 29 % of the poses lost in short gaps, as in a real room."""
    rng, t = np.random.default_rng(0), clock(30, 100)
    starts = np.sort(rng.choice(len(t), 588, replace=False))
    lost = np.zeros(len(t), bool)
    for start, length in zip(starts, rng.geometric(0.6, 588), strict=True):
        lost[start : start + min(length, 9)] = True
    resting = noisy(Trajectory(t[~lost], np.tile(np.eye(4), ((~lost).sum(), 1, 1)), GAP))
    assert len(still(resting)) == 1


@pytest.mark.parametrize("rate_hz", [4, 5, 10, 15])
def test_rests_are_found_by_motion_capture_slower_than_20_hz(rate_hz):
    t = clock(9, rate_hz)
    s = np.clip(t / NS_PER_S - 4, 0, 1)
    T = make_pose(t=(0.5 * (3 * s**2 - 2 * s**3))[:, None] * [1, 0, 0])
    slow = noisy(Trajectory(t, T, longest_gap_ns(t, 0.05)))
    spans = still(slow)
    assert spans.shape == (2, 2)
    assert spans[0, 1] > 2.8 and spans[1, 0] < 6.2
    assert spans[0, 1] < 4.0 and spans[1, 0] > 5.0


def test_the_longest_gap_of_a_slow_stream_is_longer_than_configured():
    assert longest_gap_ns(clock(5, 100), 0.05) == 0.05 * NS_PER_S
    assert longest_gap_ns(clock(5, 10), 0.05) == pytest.approx(0.15 * NS_PER_S, rel=0.01)
    assert longest_gap_ns(np.zeros(1, np.int64), 0.05) == 0.05 * NS_PER_S


def test_the_trim_is_taken_off_both_ends():
    spans = still(moving(clock(5)), trim_s=0.5)
    assert spans == pytest.approx(np.array([[0.65, 4.35]]))


def test_an_interval_is_kept_from_its_least_duration_after_the_trim():
    body = moving(clock(1.0))
    assert len(still(body, trim_s=0.1, min_duration_s=0.5)) == 1
    assert len(still(body, trim_s=0.1, min_duration_s=0.51)) == 0
    assert still(body, trim_s=0.4, min_duration_s=0.0).shape == (0, 2)


def test_no_sample_is_no_stillness():
    assert still(moving(clock(1)[:0])).shape == (0, 2)


# --- effective samples


def test_white_noise_counts_nearly_every_sample():
    xi = np.random.default_rng(0).normal(size=(2000, 6))
    assert 1400 < count_effective_samples(xi - xi.mean(0)) <= 2000


def test_a_random_walk_counts_few():
    xi = np.cumsum(np.random.default_rng(0).normal(size=(2000, 6)), 0)
    assert count_effective_samples(xi - xi.mean(0)) < 20


@pytest.mark.parametrize("seed", range(3))
def test_a_first_order_process_counts_as_its_theory_says(seed):
    """Correlation a^k: n (1 - a) / (1 + a) = 4000 · 0.1 / 1.9 = 211."""
    rng = np.random.default_rng(seed)
    xi = np.zeros((4000, 6))
    for i in range(1, 4000):
        xi[i] = 0.9 * xi[i - 1] + rng.normal(size=6)
    assert count_effective_samples(xi - xi.mean(0)) == pytest.approx(211, rel=0.3)


def test_samples_sent_twice_count_once():
    xi = np.repeat(np.random.default_rng(0).normal(size=(1000, 6)), 2, 0)
    assert count_effective_samples(xi - xi.mean(0)) < 1100


def test_identical_poses_are_one_measurement():
    assert count_effective_samples(np.zeros((500, 6))) == 1


@pytest.mark.parametrize("n", [1, 2, 3])
def test_few_samples_are_one_measurement(n):
    assert count_effective_samples(np.random.default_rng(0).normal(size=(n, 6))) == 1


# --- recorded streams


def recorded(name, separator=None):
    """Stamps, positions, quaternions of a recorded stream, one pose a line."""
    lines = find_shared_data(f"mcs/{name}").read_text().splitlines()
    rows = [line.split(separator) for line in lines if not line.startswith("#")]
    t = np.array([int(Decimal(r[0].strip()) * NS_PER_S) for r in rows])
    values = np.array([r[1:] for r in rows], float)
    return t, values[:, :3], values[:, 3:]


def loaded(name, max_gap_s, separator=None):
    """Trajectory of a recorded stream without its faults, and the faults."""
    t, xyz, quat = recorded(name, separator)
    fault = flag_poses(t, xyz, quat)
    columns = dict(body=np.full(len(t), "body"), stamp_ns=t, xyz=xyz, quat=quat, fault=fault)
    return trajectory_from_columns(columns, "body", max_gap_s), fault


def between(t):
    """Times in the middle between samples."""
    return t[:-1] + np.diff(t) // 2


def test_tum_fr2_desk_has_one_stamp_that_does_not_increase_and_no_pose_in_its_gaps():
    """Six poses came late, 6 to 7.6 ms after the one before and 0.1 ms before the next; the jump is
    across a gap, in which a body may go anywhere."""
    body, fault = loaded("tum_fr2_desk.txt", 0.05)
    assert len(fault) == 20957
    kinds = dict(zip(*(a.tolist() for a in np.unique(fault, return_counts=True)), strict=True))
    assert kinds == {"": 20950, "stamp not increasing": 1, "stamp in a burst": 6}
    known = body.poses_at(between(body.stamps_ns))[1]
    gaps = np.diff(body.stamps_ns) > 50 * MS
    assert (known == ~gaps).all() and gaps.sum() == 55
    longest = np.diff(body.stamps_ns).argmax()
    assert np.diff(body.stamps_ns)[longest] / NS_PER_S == pytest.approx(11.987, abs=0.001)
    across = body.poses[longest + 1, :3, 3] - body.poses[longest, :3, 3]
    assert np.linalg.norm(across) == pytest.approx(1.26, abs=0.01)
    assert not known[longest]


def test_tum_vi_room1_has_27_gaps_longer_than_two_periods_and_no_fault():
    body, fault = loaded("tum_vi_room1.txt", 2 * 0.00833)
    assert (fault == "").all() and len(fault) == 16541
    known = body.poses_at(between(body.stamps_ns))[1]
    assert (~known).sum() == 27
    assert np.diff(body.stamps_ns).max() / NS_PER_S == pytest.approx(1.058, abs=0.001)


def test_no_still_interval_of_tum_vi_room1_spans_a_gap():
    body, _ = loaded("tum_vi_room1.txt", 0.05)
    limits = StillnessLimits(
        window_s=WINDOW_S,
        max_linear_mps=0.05,
        max_angular_radps=np.radians(5),
        trim_s=0.0,
        min_duration_s=0.0,
        max_rest_gap_s=0.0,
    )
    spans = find_still_intervals(body, limits)
    gaps = body.stamps_ns[:-1][np.diff(body.stamps_ns) > body.max_gap_ns]
    assert len(spans) and len(gaps) == 7
    assert not any(((spans[:, 0] <= g) & (g < spans[:, 1])).any() for g in gaps)


def test_the_vicon_stream_of_asl_repeats_five_stamps():
    _, fault = loaded("asl_vicon.csv", 0.05, ",")
    assert fault[fault != ""].tolist() == ["stamp not increasing"] * 5
