"""Faults of motion capture."""

import numpy as np

from calib.geometry.se3 import pose_from_rpy, pose_from_xyz_quat, pose_to_quat
from calib.geometry.units import NS_PER_S
from helpers.fault_catalog.fault_case import (
    BOARD_BODY,
    CYLINDER_BODY,
    NS_PER_MS,
    ROBOT_BODY,
    TF_TOPIC,
    FaultCase,
    damage_topic,
    damage_transforms,
    drop_rows,
    make_time_filter,
    read_header_stamp,
    read_quaternion,
    seconds_since_start,
    set_header_stamp,
    set_quaternion,
    shift_transform,
)
from simulation.world.smooth_motion import SIMULATION_START_NS


def zero_pose(item, number):
    shift_transform(item, *(-getattr(item.transform.translation, a) for a in "xyz"))
    set_quaternion(item, 0.0, 0.0, 0.0, 1.0)


def set_nan_position(item, number):
    item.transform.translation.x = float("nan")


def lengthen_quaternion(item, number):
    set_quaternion(item, *(1.2 * c for c in read_quaternion(item)))


def reorder_to_wxyz(item, number):
    x, y, z, w = read_quaternion(item)
    set_quaternion(item, w, x, y, z)


def turn_over_board(item, number):
    x, y, z, w = read_quaternion(item)
    set_quaternion(item, y, -x, w, -z)


def add_position_spike(item, number):
    if number % 40 == 0:
        shift_transform(item, 0.5, -0.2)


def scale_to_millimetres(item, number):
    for axis in "xyz":
        setattr(item.transform.translation, axis, 1000 * getattr(item.transform.translation, axis))


def rotate_map_y_up(item, number):
    up = pose_from_rpy([0, 0, 0], [-np.pi / 2, 0, 0])
    p = item.transform.translation
    T = up @ pose_from_xyz_quat([p.x, p.y, p.z], read_quaternion(item))
    p.x, p.y, p.z = T[:3, 3].tolist()
    set_quaternion(item, *pose_to_quat(T).tolist())


def freeze_poses(body, is_affected):
    """A damage that sends the last pose again in those times."""

    def damage(rows):
        last = {}

        def again(item, number):
            if is_affected(seconds_since_start(item.header)) and last:
                item.transform = last["seen"]
            last["seen"] = item.transform

        return damage_transforms(again, body)(rows)

    return damage


def swap_body_names(is_affected):
    """A damage by which board and cylinder are called by each other's name in those times."""
    other = {BOARD_BODY: CYLINDER_BODY, CYLINDER_BODY: BOARD_BODY}

    def rename(item, number):
        item.child_frame_id = other.get(item.child_frame_id, item.child_frame_id)

    return damage_transforms(rename, None, is_affected)


def change_pose_stamps(change_stamp):
    """A damage that puts change(stamp in ns, number) in place of the stamps of all poses."""

    def of_message(message, number):
        for item in message.transforms:
            set_header_stamp(item.header, change_stamp(read_header_stamp(item.header), number))

    return damage_topic(TF_TOPIC, of_message)


def drop_poses(body=None, is_affected=lambda t: True):
    """A damage that leaves out the poses of a body (None: the messages) in those times."""

    def damage(rows):
        for row in rows:
            if row[1] == TF_TOPIC:
                row[3].transforms = [
                    item
                    for item in row[3].transforms
                    if not (
                        body in (None, item.child_frame_id)
                        and is_affected(seconds_since_start(item.header))
                    )
                ]
        return [r for r in rows if r[1] != TF_TOPIC or r[3].transforms]

    return damage


def publish_separately(body, topic, delay_ns):
    """A damage that sends a body by a topic of its own, with stamps that are late by ns."""

    def damage(rows):
        out = []
        for t, name, kind, message in rows:
            mine = []
            if name == TF_TOPIC:
                mine = [i for i in message.transforms if i.child_frame_id == body]
                message.transforms = [i for i in message.transforms if i.child_frame_id != body]
            for item in mine:
                set_header_stamp(item.header, read_header_stamp(item.header) + delay_ns)
            out.append((t, name, kind, message))
            out += [(t, topic, kind, type(message)(transforms=mine))] if mine else []
        return out

    return damage


def drop_random_third(rows):
    gone = np.random.default_rng(0).uniform(size=len(rows)) < 1 / 3
    return [r for r, lost in zip(rows, gone, strict=True) if r[1] != TF_TOPIC or not lost]


def knock_cylinder_markers(rows):
    def move(item, number):
        shift_transform(item, 0.02, 0.01)

    return damage_transforms(move, CYLINDER_BODY, lambda t: t > 8.5)(rows)


def send_in_bursts(rows):
    """Stamps by a computer that gets every tenth lot of five messages at once."""

    def change_stamp(t, number):
        n_later = 4 - number % 5  # messages of the lot that are still to come
        is_burst = number // 5 % 10 == 0
        return t + n_later * 10 * NS_PER_MS - n_later * NS_PER_MS // 2 if is_burst else t

    return change_pose_stamps(change_stamp)(rows)


def rename_body(old_name, new_name):
    def rename(item, number):
        item.child_frame_id = item.child_frame_id.replace(old_name, new_name)

    return damage_transforms(rename)


def change_map_frame(item, number):
    item.header.frame_id = "vicon/world"


MOCAP_FAULTS = {
    "zeros": FaultCase(
        "a board that is occluded for 0.3 s again and again is sent at the origin",
        "× zeros",
        damage_transforms(zero_pose, BOARD_BODY, make_time_filter(0.4, 0.3)),
    ),
    "frozen": FaultCase(
        "the robot is lost for 0.4 s again and again, its last pose is sent meanwhile",
        "× frozen",
        freeze_poses(ROBOT_BODY, make_time_filter(0.9, 0.4)),
    ),
    "frozen_to_end": FaultCase(
        "the board is lost for good in a move, its last pose is sent to the end",
        "× frozen",
        freeze_poses(BOARD_BODY, lambda t: t > 12.8),
    ),
    "nan": FaultCase(
        "NaN where the board is not seen",
        "× not a number",
        damage_transforms(set_nan_position, BOARD_BODY, make_time_filter(0.4, 0.3)),
    ),
    "not_unit": FaultCase(
        "quaternions of the robot that are 20 % too long for 0.3 s again and again",
        "× quaternion not unit",
        damage_transforms(lengthen_quaternion, ROBOT_BODY, make_time_filter(0.4, 0.3)),
    ),
    "wxyz": FaultCase(
        "quaternions as wxyz throughout",
        "quaternion order may be w, x, y, z",
        damage_transforms(reorder_to_wxyz),
    ),
    "spikes": FaultCase(
        "every fortieth pose of the board is 0.5 m off",
        "× jump",
        damage_transforms(add_position_spike, BOARD_BODY),
    ),
    "turned_over": FaultCase(
        "markers of the board are taken for each other for 0.3 s again and again: it turns over",
        "× jump",
        damage_transforms(turn_over_board, BOARD_BODY, make_time_filter(0.4, 0.3)),
    ),
    "names_swapped": FaultCase(
        "board and cylinder swap their names for 0.3 s again and again",
        "× names swapped",
        swap_body_names(make_time_filter(0.4, 0.3)),
    ),
    "names_exchanged": FaultCase(
        "board and cylinder have each other's name throughout",
        "`body` of the target",
        swap_body_names(lambda t: True),
    ),
    "gaps": FaultCase(
        "no motion capture for 0.2 s again and again",
        "gaps",
        drop_poses(None, make_time_filter(0.4, 0.2)),
    ),
    "third_lost": FaultCase("every third message is lost, at random", "gaps", drop_random_third),
    "robot_lost": FaultCase(
        "the robot is not seen in the last quarter of the log",
        "gap",
        drop_poses(ROBOT_BODY, lambda t: t > 13.0),
    ),
    "stamps_repeated": FaultCase(
        "every second message has the stamp of the one before",
        "× stamp not increasing",
        change_pose_stamps(lambda t, i: t - i % 2 * 10 * NS_PER_MS),
    ),
    "stamps_backward": FaultCase(
        "every twentieth stamp is 35 ms early",
        "× stamp not increasing",
        change_pose_stamps(lambda t, i: t - 35 * NS_PER_MS if i % 20 == 7 else t),
    ),
    "stamp_ahead": FaultCase(
        "one stamp is 100 s ahead",
        "× stamp not increasing",
        change_pose_stamps(lambda t, i: t + 100 * NS_PER_S if i == 300 else t),
    ),
    "bursts": FaultCase(
        "messages wait for each other: of every tenth lot of five, stamps 0.5 ms apart",
        "× stamp in a burst",
        send_in_bursts,
    ),
    "no_stamps": FaultCase(
        "no stamps: log times are used, 4 to 6 ms late",
        "log time: most messages have no stamp",
        change_pose_stamps(lambda t, i: 0),
    ),
    "stamps_stand_still": FaultCase(
        "one stamp for all",
        "log time: most stamps do not increase",
        change_pose_stamps(lambda t, i: SIMULATION_START_NS),
    ),
    "another_clock": FaultCase(
        "stamps of a clock that is an hour behind the log's",
        "shifted by",
        change_pose_stamps(lambda t, i: t - 3600 * NS_PER_S),
    ),
    "late_clock": FaultCase(
        "stamps that are 25 ms late",
        "time offset",
        simulate_arguments="--mcs-late-s 0.025",
        note="Found to 0.6 ms; other frames fall into the rests, and their draw is what is left",
    ),
    "drifting_clock": FaultCase(
        "a clock that runs 500 ppm fast",
        "clock drift",
        simulate_arguments="--mcs-drift-ppm 500",
    ),
    "board_late": FaultCase(
        "the board comes by a topic of its own, whose stamps are 12 ms late",
        "board: stamps -12",
        publish_separately(BOARD_BODY, "/tf_board", 12 * NS_PER_MS),
        change_config=lambda session, rig, targets: rig["mocap"].update(
            topics=["/tf", "/tf_board"]
        ),
    ),
    "millimetres": FaultCase(
        "positions in millimetres", "millimetres", damage_transforms(scale_to_millimetres)
    ),
    "y_up": FaultCase("a map whose y axis points up", "", damage_transforms(rotate_map_y_up)),
    "body_missing": FaultCase(
        "the cylinder was not tracked",
        "MCS body mocap/cylinder is not in the log",
        drop_poses(CYLINDER_BODY),
    ),
    "robot_renamed": FaultCase(
        "the robot has another name than in the rig",
        "MCS body mocap/robot is not in the log",
        rename_body("robot", "robot_1"),
    ),
    "no_mocap": FaultCase(
        "no motion capture in the log",
        "is not in the log",
        drop_rows(lambda row, i: row[1] == TF_TOPIC),
    ),
    "another_map": FaultCase(
        "poses in another frame than the rig's map",
        "has no transform to",
        damage_transforms(change_map_frame),
    ),
    "target_knocked": FaultCase(
        "markers of the cylinder are knocked by 22 mm half-way",
        "cylinder is shifted in its MCS body from its placement 5",
        knock_cylinder_markers,
    ),
}
