"""Faults of motion capture, each found by its rule and counted, and nothing else lost."""

import time
from collections import Counter

import numpy as np
import pytest

from calib.decoding.body_tracks import bodies_in_map
from calib.decoding.stream_clocks import StreamClock, match_streams_to_log
from calib.geometry.se3 import make_pose, pose_from_rpy, pose_from_xyz_quat, pose_to_quat, se3_exp
from calib.io.logs.ros_messages import IMAGE_TYPE, make_tf_message
from calib.io.stage_cli import write_json
from calib.mocap.messages.pose_messages import POSE_READERS
from calib.mocap.pose_conventions import to_xyzw
from calib.mocap.pose_faults import flag_poses
from calib.mocap.swapped_bodies import flag_swaps
from helpers.driver_recordings import make_mocap_rows, record_driver_scene
from helpers.log_containers import (
    BOARD_BODY,
    CONTAINER_START_NS,
    MAP_FRAME,
    NS_PER_MS,
    ROBOT_BODY,
    container_decode_options,
    decode_tables,
    make_container_rows,
    make_small_image,
    serialize_cdr,
    write_test_mcap,
)

S = 1_000_000_000
NOISE = np.repeat([0.0002, np.radians(0.02)], 3)


def moving(n=400, hz=100, seed=0, noise=NOISE):
    """Stamps, positions and quaternions of a body that is carried about for n samples."""
    t = np.arange(n) * (S // hz)
    s = (t / S)[:, None]
    xi = np.hstack([np.sin(s * [0.7, 1.1, 0.4]), 0.4 * np.cos(s * [0.3, 0.5, 0.2])])
    xi += noise * np.random.default_rng(seed).normal(size=(n, 6))
    T = make_pose(t=[1.0, 2.0, 0.8]) @ se3_exp(xi)
    return t, T[:, :3, 3].copy(), pose_to_quat(T)


def found(t, xyz, quat):
    """{fault: numbers of the poses that have it}."""
    fault = flag_poses(t, xyz, quat)
    return {k: np.flatnonzero(fault == k).tolist() for k in sorted(set(fault.tolist()) - {""})}


def span(first, last):
    return list(range(first, last))


def test_a_body_that_is_carried_about_has_no_fault():
    assert found(*moving()) == {}


def test_a_body_that_rests_has_no_fault_whether_its_poses_have_noise_or_repeat():
    t, xyz, quat = moving()
    for rest in (xyz * 0 + xyz[0], xyz[0] + 1e-4 * np.random.default_rng(0).normal(size=xyz.shape)):
        assert found(t, rest, quat * 0 + quat[0]) == {}


def test_a_body_without_noise_that_stops_and_goes_on_is_never_frozen():
    t = np.arange(600) * 10 * NS_PER_MS
    way = np.interp(np.arange(600), [0, 200, 400, 600], [0, 0, np.pi, np.pi])
    xyz = np.column_stack([1 - np.cos(way), np.ones(600), np.ones(600)])
    assert found(t, xyz, np.tile([0, 0, 0, 1.0], (600, 1))) == {}


def test_a_pose_sent_again_while_the_body_moves_on_is_frozen():
    t, xyz, quat = moving()
    xyz[101:150], quat[101:150] = xyz[100], quat[100]
    assert found(t, xyz, quat) == {"frozen": span(101, 150)}


def test_a_body_lost_up_to_the_end_is_frozen():
    t, xyz, quat = moving()
    xyz[301:], quat[301:] = xyz[300], quat[300]
    assert found(t, xyz, quat) == {"frozen": span(301, 400)}


def test_a_single_wrong_pose_is_a_jump():
    t, xyz, quat = moving()
    xyz[70] += 0.5
    assert found(t, xyz, quat) == {"jump": [70]}


def test_a_body_that_turns_over_from_one_pose_to_the_next_is_a_jump():
    """Markers that are nearly symmetric are taken for each other."""
    t, xyz, quat = moving()
    x, y, z, w = quat[200:220].T
    quat[200:220] = np.column_stack([y, -x, w, -z])
    assert found(t, xyz, quat) == {"jump": span(200, 220)}


def test_names_that_are_swapped_for_a_while_are_a_jump_of_both():
    t, xyz, quat = moving()
    _, other, turned = moving(seed=1)
    other = other + [2.0, 0, 0]
    swap = slice(120, 150)
    xyz[swap], other[swap] = other[swap].copy(), xyz[swap].copy()
    for track in ((xyz, quat), (other, turned)):
        assert found(t, *track) == {"jump": span(120, 150)}


def track(t, xyz, quat):
    """Columns of a body, each pose with its fault."""
    return {"stamp_ns": t, "xyz": xyz, "quat": quat, "fault": flag_poses(t, xyz, quat)}


def two_bodies():
    """Columns of a robot and of a board 2 m beside it, before their faults are told."""
    t, xyz, quat = moving()
    _, other, turned = moving(seed=1)
    return (t, xyz, quat), (t.copy(), other + [2.0, 0, 0], turned)


def named(*bodies):
    """{fault: number of poses} of bodies that are looked at together."""
    tracks = flag_swaps({str(i): track(*b) for i, b in enumerate(bodies)})
    return [Counter(c["fault"][c["fault"] != ""].tolist()) for c in tracks.values()]


@pytest.mark.parametrize("swap", [slice(120, 150), slice(0, 30), slice(370, 400)])
def test_names_that_two_bodies_exchange_are_said_to_be_swapped(swap):
    one, other = two_bodies()
    one[1][swap], other[1][swap] = other[1][swap].copy(), one[1][swap].copy()
    one[2][swap], other[2][swap] = other[2][swap].copy(), one[2][swap].copy()
    assert named(one, other) == [{"names swapped": 30}, {"names swapped": 30}]


def test_a_body_that_jumps_to_where_no_other_was_is_not_swapped():
    one, other = two_bodies()
    one[1][120:150] += [0, 0, 1.5]
    other[1][125:150] += [0, 0, 2.5]
    assert named(one, other) == [{"jump": 30}, {"jump": 25}]


def test_a_body_that_jumps_to_where_another_still_is_is_not_swapped():
    one, other = two_bodies()
    one[1][120:150], one[2][120:150] = other[1][120:150], other[2][120:150]
    assert named(one, other) == [{"jump": 30}, {}]


def test_of_a_track_that_jumps_for_good_the_longer_part_holds():
    t, xyz, quat = moving()
    xyz[:100] += [0, 0, 1.0]
    assert found(t, xyz, quat) == {"jump": span(0, 100)}


def test_after_a_gap_a_body_may_be_anywhere():
    t, xyz, quat = moving()
    t[200:] += 2 * S
    xyz[200:] += 3.0
    assert found(t, xyz, quat) == {}


def test_poses_that_waited_for_each_other_came_late_but_for_the_last():
    t, xyz, quat = moving()
    t[100:104] = t[104] - np.arange(4, 0, -1) * NS_PER_MS // 5
    assert found(t, xyz, quat) == {"stamp in a burst": span(100, 104)}


def test_a_stamp_that_runs_ahead_spoils_no_other():
    t, xyz, quat = moving()
    t[50] += 1000 * S
    assert found(t, xyz, quat) == {"stamp not increasing": [50]}


@pytest.mark.parametrize("value", [2e8, 1e300])
def test_a_position_beyond_any_map_is_out_of_range(value):
    t, xyz, quat = moving()
    xyz[9, 1] = value
    assert found(t, xyz, quat) == {"out of range": [9]}


def test_all_faults_at_once_are_told_apart():
    t, xyz, quat = moving(800)
    xyz[101:150], quat[101:150] = xyz[100], quat[100]
    xyz[200:210], quat[200:210] = 0, 0
    xyz[300] = np.nan
    quat[400:405] *= 1.1
    xyz[500:520] += 0.7
    t[600] = t[599]
    t[700:703] = t[703] - np.arange(3, 0, -1) * NS_PER_MS // 5
    assert found(t, xyz, quat) == {
        "frozen": span(101, 150),
        "quaternion not unit": [*span(200, 200), *span(400, 405)],
        "zeros": span(200, 210),
        "not a number": [300],
        "jump": span(500, 520),
        "stamp not increasing": [600],
        "stamp in a burst": span(700, 703),
    }


# --- order of quaternions


def edges(xyz, quat):
    return {(MAP_FRAME, ROBOT_BODY): {"xyz": xyz, "quat": quat}}


def driving(n=500):
    """A robot that drives and turns on a floor: positions, quaternions."""
    yaw = np.linspace(0, 5, n)
    xyz = np.column_stack([2 * np.sin(yaw), 2 * np.cos(yaw), 0.3 + 0.001 * np.sin(9 * yaw)])
    xi = np.column_stack([np.zeros((n, 5)), yaw])
    T = se3_exp(xi) @ pose_from_rpy([0, 0, 0], [0.1, 0.2, 0.3])
    return xyz, pose_to_quat(T)


def test_quaternions_as_wxyz_are_put_right_where_a_robot_drives():
    xyz, quat = driving()
    taken, words = to_xyzw(edges(xyz, np.roll(quat, 1, axis=1)))
    assert taken[MAP_FRAME, ROBOT_BODY]["quat"] == pytest.approx(quat)
    assert [w.split(":")[0] for w in words] == ["quaternions read as w, x, y, z"]
    assert to_xyzw(edges(xyz, quat))[1] == []


@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
def test_a_configured_order_of_quaternions_is_taken_without_a_word(order):
    xyz, quat = driving()
    sent = np.roll(quat, 1, axis=1)
    taken, words = to_xyzw(edges(xyz, sent), order)
    expected = quat if order == "wxyz" else sent
    assert taken[MAP_FRAME, ROBOT_BODY]["quat"] == pytest.approx(expected) and words == []


def test_quaternions_that_may_be_wxyz_are_told_where_a_robot_hardly_moves():
    xi = 0.05 * np.random.default_rng(0).normal(size=(200, 6))
    T = se3_exp(xi)
    xyz, quat = T[:, :3, 3], pose_to_quat(T)
    taken, words = to_xyzw(edges(xyz, np.roll(quat, 1, axis=1)))
    assert [w.split(":")[0] for w in words] == ["quaternion order may be w, x, y, z"]
    assert (
        ROBOT_BODY in words[0]
        and (taken[MAP_FRAME, ROBOT_BODY]["quat"] == np.roll(quat, 1, axis=1)).all()
    )
    assert to_xyzw(edges(xyz, quat))[1] == []


def test_a_map_whose_y_axis_points_up_is_told():
    xyz, quat = driving()
    up = pose_from_rpy([0, 0, 0], [-np.pi / 2, 0, 0])
    T = up @ pose_from_xyz_quat(xyz, quat)
    taken, words = to_xyzw(edges(T[:, :3, 3], pose_to_quat(T)))
    assert [w.split(":")[0] for w in words] == ["the y axis of the map points up"]


# --- clocks


def told(delays, jitter=2 * NS_PER_MS):
    """clocks() of streams of 50 messages each, late by so many ns."""
    rng, log_t = np.random.default_rng(0), CONTAINER_START_NS + np.arange(50) * 10 * NS_PER_MS
    return match_streams_to_log(
        {k: (log_t - d - rng.integers(0, jitter, 50), log_t) for k, d in delays.items()}
    )


def test_stamps_near_the_log_s_times_stay_as_they_are():
    clocks = told({"/tf": 5 * NS_PER_MS, "lidar": 120 * NS_PER_MS, "camera": -3 * NS_PER_MS})
    assert {c.shift_ns for c in clocks.values()} == {0}
    assert clocks["lidar"].delay_ns == pytest.approx(121 * NS_PER_MS, abs=NS_PER_MS)
    assert clocks["lidar"].stamp_source == "header"


def test_a_clock_far_from_the_log_s_is_moved_onto_it():
    clocks = told({"/tf": 3600 * S, "lidar": 120 * NS_PER_MS})
    assert clocks["/tf"].shift_ns == pytest.approx(3600 * S, abs=3 * NS_PER_MS)
    assert clocks["/tf"].stamp_source == "header, shifted by +3600.001 s to the log's clock"
    assert clocks["lidar"].shift_ns == 0


def test_streams_of_one_far_clock_stay_together():
    """The lidar's messages take 0.1 s longer than the poses: no reason to move it by more."""
    clocks = told({"/tf": -37 * S, "lidar": -37 * S + 100 * NS_PER_MS, "camera": 20 * NS_PER_MS})
    assert (
        clocks["/tf"].shift_ns
        == clocks["lidar"].shift_ns
        == pytest.approx(-37 * S, abs=3 * NS_PER_MS)
    )
    assert clocks["camera"].shift_ns == 0


def test_log_times_stand_for_stamps_that_are_missing_or_stand_still():
    log_t = CONTAINER_START_NS + np.arange(50) * 10 * NS_PER_MS
    clocks = match_streams_to_log(
        {"a": (np.full(50, -1), log_t), "b": (np.full(50, CONTAINER_START_NS), log_t)}
    )
    assert clocks["a"].stamp_source == "log time: most messages have no stamp"
    assert clocks["b"].stamp_source == "log time: most stamps do not increase"
    for clock in clocks.values():
        assert (
            clock.message_times_ns(np.full(50, -1), log_t) == log_t
        ).all() and clock.delay_ns is None


def test_a_message_without_a_stamp_among_others_has_its_log_time():
    clock = StreamClock(5, "", 5)
    assert clock.message_times_ns(np.array([100, -1]), np.array([107, 209])).tolist() == [105, 209]


# --- frames between the map and a body


def columns(t, T, fault=""):
    n = len(t)
    fault = np.full(n, fault, "U24")
    turned = pose_to_quat(T)
    return {
        "stamp_ns": t,
        "log_time_ns": t + NS_PER_MS,
        "xyz": T[:, :3, 3],
        "quat": turned,
        "fault": fault,
    }


def twist(t, xi):
    return se3_exp(t[:, None] / S * np.asarray(xi, float))


def composed(found, static, body="body", gap=50 * NS_PER_MS):
    blocks = {e: {"xyz_m": T[:3, 3], "quat_xyzw": pose_to_quat(T)} for e, T in static.items()}
    return bodies_in_map(
        found, blocks, map_frame=MAP_FRAME, wanted_bodies=[body], max_gap_ns=gap
    ).get(body)


UP = make_pose(t=[0, 0, 1.5])
SLOW, FAST = (
    np.arange(0, 2 * S, 20 * NS_PER_MS),
    np.arange(5 * NS_PER_MS, int(1.9 * S), 10 * NS_PER_MS),
)
BASE, ARM = [0.2, 0, 0.1, 0, 0, 0.5], [0, 0.1, 0, 0.3, 0, 0]


def test_a_body_below_a_static_frame_is_given_in_the_map():
    found = {("tracker", "body"): columns(FAST, twist(FAST, ARM))}
    body = composed(found, {(MAP_FRAME, "tracker"): UP})
    T = pose_from_xyz_quat(body["xyz"], body["quat"])
    assert np.abs(T - UP @ twist(FAST, ARM)).max() < 1e-14 and (body["stamp_ns"] == FAST).all()


def test_a_body_on_a_static_frame_of_another_is_given_at_that_one_s_stamps():
    found = {(MAP_FRAME, "markers"): columns(SLOW, twist(SLOW, BASE))}
    body = composed(found, {("markers", "body"): UP})
    T = pose_from_xyz_quat(body["xyz"], body["quat"])
    assert np.abs(T - twist(SLOW, BASE) @ UP).max() < 1e-14 and (body["stamp_ns"] == SLOW).all()


def test_a_frame_in_between_is_interpolated_at_the_body_s_stamps():
    found = {
        (MAP_FRAME, "base"): columns(SLOW, twist(SLOW, BASE)),
        ("base", "arm"): columns(FAST, twist(FAST, ARM)),
    }
    body = composed(found, {("arm", "body"): UP})
    T = pose_from_xyz_quat(body["xyz"], body["quat"])
    assert np.abs(T - twist(FAST, BASE) @ twist(FAST, ARM) @ UP).max() < 1e-12


def test_a_pose_without_one_of_its_parent_is_a_fault_and_one_with_a_fault_keeps_it():
    upper = columns(SLOW, twist(SLOW, BASE))
    upper["fault"][40:50] = "jump"
    lower = columns(FAST, twist(FAST, ARM))
    lower["fault"][3] = "zeros"
    body = composed({(MAP_FRAME, "base"): upper, ("base", "body"): lower}, {})
    gap = np.abs(FAST - 890 * NS_PER_MS) < 110 * NS_PER_MS
    assert (body["fault"][gap] == "no pose of its parent").all()
    assert body["fault"][3] == "zeros" and ((body["fault"] == "") == ~gap).sum() == len(FAST) - 1


def test_a_body_that_stands_in_the_map_is_there_whenever_another_is():
    found = {(MAP_FRAME, "robot"): columns(FAST, twist(FAST, ARM))}
    body = composed(found, {(MAP_FRAME, "body"): UP})
    assert (body["stamp_ns"] == FAST).all() and (body["xyz"] == UP[:3, 3]).all()


@pytest.mark.parametrize(
    "static", [{}, {("other", "body"): UP}, {("a", "body"): UP, ("body", "a"): UP}]
)
def test_a_body_that_nothing_connects_to_the_map_is_not_there(static):
    assert composed({(MAP_FRAME, "robot"): columns(FAST, twist(FAST, ARM))}, static) is None


# --- in a log


def test_a_body_on_a_static_frame_of_one_that_hangs_from_another_is_found_in_a_log(tmp_path):
    """Map - (static) - tracker - plate - (static) - robot, each link in its own message."""
    rows = make_mocap_rows("TFMessage, a chain")
    options = container_decode_options("TFMessage")
    poses, _, audit = decode_tables(str(write_test_mcap(tmp_path / "a.mcap", rows)), options)
    known = record_driver_scene()
    for body in (ROBOT_BODY, BOARD_BODY):
        assert audit["bodies"][body]["status"]["ok"]
        mine = poses["body"] == body
        T = pose_from_xyz_quat(poses["xyz"][mine], poses["quat"][mine])
        assert np.abs(T - known.body_poses[body]).max() < 1e-12
        assert (poses["stamp_ns"][mine] == known.mocap_times_ns).all()


def recorded(tmp_path, rows, **mocap):
    """log.json and the poses of a log of rows, with the block `mocap` of its kind changed."""
    options = container_decode_options("TFMessage")
    options["mocap"] |= mocap
    poses, _, audit = decode_tables(str(write_test_mcap(tmp_path / "a.mcap", rows)), options)
    return audit, poses


def test_the_audit_counts_faults_gaps_and_says_which_times_were_used(tmp_path):
    rows = make_container_rows("TFMessage", 60)
    tf = [r for r in rows if r[1] == "/tf"]
    tf[10][3].transforms[0].transform.translation.x = float("nan")
    rows = [r for r in rows if r not in tf[30:40]]
    audit, _ = recorded(tmp_path, rows)
    robot = audit["bodies"][ROBOT_BODY]
    assert robot["faults"] == {"not a number": 1} and robot["poses"] == 50
    assert robot["gaps"] == 1 and robot["longest_gap_s"] == pytest.approx(0.11)
    assert audit["bodies"][BOARD_BODY]["faults"] == {}
    assert audit["mocap"]["/tf"] == {"stamps": "header", "delay_s": 0.002, "found": []}
    assert audit["sensors"]["lidar"]["stamps"] == "header"
    assert audit["sensors"]["lidar"]["delay_s"] == pytest.approx(0.006)


def test_a_body_that_is_not_seen_to_the_end_has_a_gap_there(tmp_path):
    rows = make_container_rows("TFMessage", 60)
    for _, topic, _, message in rows[-60:]:
        if topic == "/tf":
            message.transforms = [m for m in message.transforms if m.child_frame_id == BOARD_BODY]
    audit, poses = recorded(tmp_path, rows)
    last = [poses["stamp_ns"][poses["body"] == name].max() for name in (ROBOT_BODY, BOARD_BODY)]
    assert audit["bodies"][ROBOT_BODY]["gaps"] == 1 and audit["bodies"][BOARD_BODY]["gaps"] == 0
    assert audit["bodies"][ROBOT_BODY]["longest_gap_s"] == pytest.approx((last[1] - last[0]) / 1e9)
    assert audit["bodies"][ROBOT_BODY]["longest_gap_s"] > 0.2


@pytest.mark.parametrize(
    "mocap, said",
    [
        ({"map": "vicon"}, "its parent frame world has no transform to vicon"),
        ({"topics": ["/image"]}, "/image carries sensor_msgs/msg/Image"),
        ({"topics": {"/points": ROBOT_BODY}}, "/points carries sensor_msgs/msg/PointCloud2"),
    ],
)
def test_a_body_that_is_not_in_the_map_says_why(tmp_path, mocap, said):
    audit, _ = recorded(tmp_path, make_container_rows("TFMessage"), **mocap)
    status = audit["bodies"][ROBOT_BODY]["status"]
    assert status["reason"] == "MCS body robot is not in the log" and status["found"] == said
    assert status["remedy"]


def test_a_topic_of_motion_capture_that_is_not_there_is_named_with_the_nearest(tmp_path):
    audit, _ = recorded(tmp_path, make_container_rows("TFMessage"), topics=["/tff"])
    status = audit["bodies"][ROBOT_BODY]["status"]
    assert status["reason"] == "MCS body robot is not in the log: topic /tff is not in the log"
    assert status["remedy"] == "Did you mean /tf?"


def test_a_body_whose_every_pose_is_a_fault_says_which(tmp_path):
    rows = make_container_rows("TFMessage")
    for _, topic, _, message in rows:
        if topic == "/tf":
            message.transforms[0].transform.rotation.w = 7.0
    audit, _ = recorded(tmp_path, rows)
    status = audit["bodies"][ROBOT_BODY]["status"]
    assert status["reason"] == "MCS body robot has no pose that can be used"
    assert status["found"] == "20 × quaternion not unit"


def test_messages_that_cannot_be_read_are_counted_and_the_others_are_taken(tmp_path):
    rows = make_container_rows("TFMessage")
    path = write_test_mcap(tmp_path / "a.mcap", rows, serialise=spoilt())
    options = container_decode_options("TFMessage")
    poses, frames, audit = decode_tables(str(path), options)
    assert (poses["body"] == ROBOT_BODY).sum() == 17 and (frames["sensor"] == "camera").sum() == 7
    (fault,) = audit["faults"]
    assert fault.startswith("3 messages of /tf could not be read and are left out: ")
    assert "a message of tf2_msgs/msg/TFMessage cannot be read (" in fault


def spoilt():
    """A serialiser that cuts the 5th to 7th TFMessage short."""
    count = iter(range(1000))

    def serialise(name, message):
        data = serialize_cdr(name, message)
        short = name == "tf2_msgs/msg/TFMessage" and next(count) in (4, 5, 6)
        return data[:-20] if short else data

    return serialise


def test_a_sensor_in_a_serialisation_that_is_not_read_says_so(tmp_path):
    form = ("protobuf", "ros2msg", 2)
    path = write_test_mcap(
        tmp_path / "a.mcap", make_container_rows("TFMessage"), message_encoding=form
    )
    _, frames, audit = decode_tables(str(path), container_decode_options("TFMessage"))
    status = audit["sensors"]["camera"]["status"]
    assert (
        len(frames["stamp_ns"]) == 0
        and status["reason"] == "no message of topic /image can be read"
    )
    assert "sensor_msgs/msg/Image is serialised as protobuf" in status["found"]


def test_a_static_transform_sent_before_from_s_is_known(tmp_path):
    T = make_tf_message(CONTAINER_START_NS, ROBOT_BODY, {"lidar": UP})
    rows = [(CONTAINER_START_NS, "/tf_static", mcs_type(), T), *make_container_rows("TFMessage")]
    options = container_decode_options("TFMessage") | {"from_s": 0.1, "bodies": ["lidar"]}
    log = str(write_test_mcap(tmp_path / "a.mcap", rows))
    poses, _, audit = decode_tables(log, options)
    assert [(e["parent"], e["child"]) for e in audit["static"]] == [(ROBOT_BODY, "lidar")]
    assert (poses["body"] == "lidar").sum() == (poses["body"] == ROBOT_BODY).sum() == 10


@pytest.mark.parametrize("kind", ["TFMessage", "Image"])
def test_a_static_transform_that_is_no_number_or_of_another_type_stops_nothing(tmp_path, kind):
    T = make_tf_message(CONTAINER_START_NS, ROBOT_BODY, {"lidar": UP})
    T.transforms[0].transform.translation.x = float("nan")
    row = (CONTAINER_START_NS, "/tf_static", mcs_type(), T)
    if kind == "Image":
        row = (CONTAINER_START_NS, "/tf_static", IMAGE_TYPE, make_small_image(CONTAINER_START_NS))
    audit, poses = recorded(tmp_path, [row, *make_container_rows("TFMessage")])
    assert audit["static"] == [] and (poses["body"] == ROBOT_BODY).sum() == 20
    write_json(tmp_path / "log.json", audit)
    assert len(audit["faults"]) == (1 if kind == "TFMessage" else 0)
    assert all("from robot to lidar is not finite" in fault for fault in audit["faults"])


def mcs_type():
    """The type of /tf_static."""
    return next(iter(POSE_READERS))


def test_a_track_that_jumps_all_the_time_is_judged_in_no_time():
    t, xyz, quat = moving(20_000)
    xyz += np.random.default_rng(3).integers(0, 50, (20_000, 1)) * 1.0
    begin = time.process_time()
    assert len(found(t, xyz, quat)["jump"]) > 19_000
    assert time.process_time() - begin < 10
