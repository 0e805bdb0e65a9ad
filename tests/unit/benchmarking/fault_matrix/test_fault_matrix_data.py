"""The faults of the matrix as data: sizes, causes, and what the changes of messages do."""

import re

import numpy as np
import pytest

from benchmarking.fault_matrix.config_mistakes import (
    WrittenConfig,
    invert_sensor_pose,
    read_sensor_pose,
    reorder_pose_quaternion,
)
from benchmarking.fault_matrix.matrix_faults import MATRIX_FAULTS
from benchmarking.fault_matrix.message_changes import knock_body, read_transform, step_clock
from benchmarking.room_rigs import ROOM_RIGS
from calib.geometry.se3 import invert_pose, make_pose, pose_from_rpy, rotation_angle
from calib.io.logs.ros_messages import (
    TF_TYPE,
    RosMessage,
    make_ros_header,
    make_ros_message,
    make_tf_message,
)
from simulate import parse_simulation_arguments

SECOND = 10**9


def test_every_row_has_a_folder_of_its_own_and_arguments_that_the_simulator_takes():
    assert len({fault.key for fault in MATRIX_FAULTS}) == len(MATRIX_FAULTS)
    for fault in MATRIX_FAULTS:
        parse_simulation_arguments(["-", *f"{fault.recording} {fault.arguments}".split()])
        assert all(re.compile(cause) for cause in fault.causes)


def test_every_fault_but_a_convention_has_two_sizes():
    conventions = {f.name for f in MATRIX_FAULTS[-9:]}
    counts = {name: sum(f.name == name for f in MATRIX_FAULTS) for name in sizes_by_name()}
    assert {name for name, n in counts.items() if n == 1} == conventions
    assert set(counts.values()) == {1, 2}


def sizes_by_name():
    return {f.name for f in MATRIX_FAULTS}


def test_the_rigs_are_four_with_motion_capture_that_wanders():
    assert len(ROOM_RIGS) == 4
    for arguments in ROOM_RIGS.values():
        args = parse_simulation_arguments(["-", *arguments.split()])
        assert args.mcs_wander_m == 0.00015
        assert args.mcs_wander_deg == [0.02, 0.07, 0.02]


def tf_rows():
    T = make_pose(t=[1.0, 2.0, 3.0])
    for second in range(11):
        t = second * SECOND
        bodies = {"mocap/board": T, "mocap/robot": T}
        yield RosMessage(t, "/tf", TF_TYPE, make_tf_message(t, "mocap/world", bodies))


def test_a_knocked_body_moves_by_the_size_of_the_knock_from_the_middle_on_and_alone():
    rows = list(knock_body("mocap/board", 0.02, 1.0)(list(tf_rows())))
    start = make_pose(t=[1.0, 2.0, 3.0])
    for second, row in enumerate(rows):
        poses = {i.child_frame_id: read_transform(i) for i in row.message.transforms}
        moved = invert_pose(start) @ poses["mocap/board"]
        size = 0.02 if second > 5 else 0.0
        assert np.linalg.norm(moved[:3, 3]) == pytest.approx(size, rel=0.01, abs=1e-12)
        angle = np.degrees(rotation_angle(moved[:3, :3]))
        assert angle == pytest.approx(50 * size, rel=0.01, abs=1e-4)
        np.testing.assert_allclose(poses["mocap/robot"], start, atol=1e-12)


def test_a_stepped_clock_moves_all_log_times_and_the_stamps_of_sensors_by_the_step():
    header = make_ros_header(8 * SECOND, "lidar")
    image = make_ros_message("std_msgs/msg/Header", stamp=header.stamp, frame_id="lidar")

    class Message:
        header = image

    rows = [*tf_rows(), RosMessage(10 * SECOND + 1, "/points", "cloud", Message())]
    stepped = list(step_clock(0.4)(rows))
    assert [r.log_time_ns for r in stepped[:6]] == [i * SECOND for i in range(6)]
    assert stepped[6].log_time_ns == 6.4 * SECOND
    stamp = stepped[6].message.transforms[0].header.stamp
    assert (stamp.sec, stamp.nanosec) == (6, 0)
    stamp = stepped[-1].message.header.stamp
    assert (stamp.sec, stamp.nanosec) == (8, 400_000_000)


def make_config():
    pose = {"xyz_m": [0.1, -0.2, 0.3], "rpy_deg": [10.0, 20.0, -70.0]}
    return WrittenConfig({}, {"sensors": {"camera": {"T_robot_sensor": pose}}}, {})


def test_an_inverted_pose_is_the_inverse_of_what_was_written():
    config = make_config()
    before = read_sensor_pose(config, "camera")
    invert_sensor_pose("camera")(config)
    after = read_sensor_pose(config, "camera")
    np.testing.assert_allclose(before @ after, np.eye(4), atol=1e-12)


def test_a_quaternion_with_w_first_has_it_first():
    config = make_config()
    T = pose_from_rpy([0.1, -0.2, 0.3], np.deg2rad([10.0, 20.0, -70.0]))
    reorder_pose_quaternion("camera")(config)
    quat = config.rig["sensors"]["camera"]["T_robot_sensor"]["quat_xyzw"]
    assert abs(quat[0]) == pytest.approx(np.cos(rotation_angle(T[:3, :3]) / 2))
