"""Faults of motion capture."""

import numpy as np

import fault
from calib.geometry import se3
from fault import BOARD, CYLINDER, MS, POSES, ROBOT, Fault, S, times, transforms
from simulation.world.smooth_motion import START_NS


def zeros(item, number):
    fault.moved(item, *(-getattr(item.transform.translation, a) for a in "xyz"))
    fault.quaternion(item, 0.0, 0.0, 0.0, 1.0)


def not_a_number(item, number):
    item.transform.translation.x = float("nan")


def longer(item, number):
    fault.quaternion(item, *(1.2 * c for c in fault.xyzw(item)))


def wxyz(item, number):
    x, y, z, w = fault.xyzw(item)
    fault.quaternion(item, w, x, y, z)


def turned_over(item, number):
    x, y, z, w = fault.xyzw(item)
    fault.quaternion(item, y, -x, w, -z)


def spike(item, number):
    if number % 40 == 0:
        fault.moved(item, 0.5, -0.2)


def millimetres(item, number):
    for axis in "xyz":
        setattr(item.transform.translation, axis, 1000 * getattr(item.transform.translation, axis))


def y_up(item, number):
    up = se3.from_rpy([0, 0, 0], [-np.pi / 2, 0, 0])
    p = item.transform.translation
    T = up @ se3.from_xyz_quat([p.x, p.y, p.z], fault.xyzw(item))
    p.x, p.y, p.z = T[:3, 3].tolist()
    fault.quaternion(item, *se3.to_quat(T).tolist())


def frozen(body, when):
    """A damage that sends the last pose again in those times."""

    def damage(rows):
        last = {}

        def again(item, number):
            if when(fault.seconds(item.header)) and last:
                item.transform = last["seen"]
            last["seen"] = item.transform

        return transforms(again, body)(rows)

    return damage


def swapped(when):
    """A damage by which board and cylinder are called by each other's name in those times."""
    other = {BOARD: CYLINDER, CYLINDER: BOARD}

    def rename(item, number):
        item.child_frame_id = other.get(item.child_frame_id, item.child_frame_id)

    return transforms(rename, None, when)


def stamps(change):
    """A damage that puts change(stamp in ns, number) in place of the stamps of all poses."""

    def of_message(message, number):
        for item in message.transforms:
            fault.set_stamp(item.header, change(fault.stamp_ns(item.header), number))

    return fault.on(POSES, of_message)


def lost(body=None, when=lambda t: True):
    """A damage that leaves out the poses of a body (None: the messages) in those times."""

    def damage(rows):
        for row in rows:
            if row[1] == POSES:
                row[3].transforms = [
                    item
                    for item in row[3].transforms
                    if not (
                        body in (None, item.child_frame_id) and when(fault.seconds(item.header))
                    )
                ]
        return [r for r in rows if r[1] != POSES or r[3].transforms]

    return damage


def on_its_own(body, topic, late):
    """A damage that sends a body by a topic of its own, with stamps that are late by ns."""

    def damage(rows):
        out = []
        for t, name, kind, message in rows:
            mine = []
            if name == POSES:
                mine = [i for i in message.transforms if i.child_frame_id == body]
                message.transforms = [i for i in message.transforms if i.child_frame_id != body]
            for item in mine:
                fault.set_stamp(item.header, fault.stamp_ns(item.header) + late)
            out.append((t, name, kind, message))
            out += [(t, topic, kind, type(message)(transforms=mine))] if mine else []
        return out

    return damage


def third_lost(rows):
    gone = np.random.default_rng(0).uniform(size=len(rows)) < 1 / 3
    return [r for r, lost in zip(rows, gone, strict=True) if r[1] != POSES or not lost]


def knocked(rows):
    def move(item, number):
        fault.moved(item, 0.02, 0.01)

    return transforms(move, CYLINDER, lambda t: t > 8.5)(rows)


def in_bursts(rows):
    """Stamps by a computer that gets every tenth lot of five messages at once."""
    return stamps(lambda t, i: t + (4 - i % 5) * 10 * MS - (4 - i % 5) * MS // 2 * 1
                  if i // 5 % 10 == 0 else t)(rows)  # fmt: skip


def renamed(old, new):
    def rename(item, number):
        item.child_frame_id = item.child_frame_id.replace(old, new)

    return transforms(rename)


def in_another_map(item, number):
    item.header.frame_id = "vicon/world"


MOCAP = {
    "zeros": Fault(
        "a board that is occluded for 0.3 s again and again is sent at the origin",
        "× zeros", transforms(zeros, BOARD, times(0.4, 0.3)),
    ),
    "frozen": Fault(
        "the robot is lost for 0.4 s again and again, its last pose is sent meanwhile",
        "× frozen", frozen(ROBOT, times(0.9, 0.4)),
    ),
    "frozen_to_end": Fault(
        "the board is lost for good in a move, its last pose is sent to the end",
        "× frozen", frozen(BOARD, lambda t: t > 12.8),
    ),
    "nan": Fault(
        "NaN where the board is not seen", "× not a number",
        transforms(not_a_number, BOARD, times(0.4, 0.3)),
    ),
    "not_unit": Fault(
        "quaternions of the robot that are 20 % too long for 0.3 s again and again",
        "× quaternion not unit", transforms(longer, ROBOT, times(0.4, 0.3)),
    ),
    "wxyz": Fault(
        "quaternions as wxyz throughout", "quaternions", transforms(wxyz),
    ),
    "spikes": Fault(
        "every fortieth pose of the board is 0.5 m off", "× jump", transforms(spike, BOARD),
    ),
    "turned_over": Fault(
        "markers of the board are taken for each other for 0.3 s again and again: it turns over",
        "× jump", transforms(turned_over, BOARD, times(0.4, 0.3)),
    ),
    "names_swapped": Fault(
        "board and cylinder swap their names for 0.3 s again and again",
        "× names swapped", swapped(times(0.4, 0.3)),
    ),
    "names_exchanged": Fault(
        "board and cylinder have each other's name throughout", "its body", swapped(lambda t: True),
    ),
    "gaps": Fault(
        "no motion capture for 0.2 s again and again", "gaps", lost(None, times(0.4, 0.2)),
    ),
    "third_lost": Fault("every third message is lost, at random", "gaps", third_lost),
    "robot_lost": Fault(
        "the robot is not seen in the last quarter of the log", "gap",
        lost(ROBOT, lambda t: t > 13.0),
    ),
    "stamps_repeated": Fault(
        "every second message has the stamp of the one before", "× stamp not increasing",
        stamps(lambda t, i: t - i % 2 * 10 * MS),
    ),
    "stamps_backward": Fault(
        "every twentieth stamp is 35 ms early", "× stamp not increasing",
        stamps(lambda t, i: t - 35 * MS if i % 20 == 7 else t),
    ),
    "stamp_ahead": Fault(
        "one stamp is 100 s ahead", "× stamp not increasing",
        stamps(lambda t, i: t + 100 * S if i == 300 else t),
    ),
    "bursts": Fault(
        "messages wait for each other: of every tenth lot of five, stamps 0.5 ms apart",
        "× stamp in a burst", in_bursts,
    ),
    "no_stamps": Fault(
        "no stamps: log times are used, 4 to 6 ms late", "log time: messages without a stamp",
        stamps(lambda t, i: 0),
    ),
    "stamps_stand_still": Fault(
        "one stamp for all", "log time: stamps that do not go on",
        stamps(lambda t, i: START_NS),
    ),
    "another_clock": Fault(
        "stamps of a clock that is an hour behind the log's", "moved by",
        stamps(lambda t, i: t - 3600 * S),
    ),
    "late_clock": Fault(
        "stamps that are 25 ms late", "time offset", simulated="--mcs-late-s 0.025",
        note="Found to 0.6 ms; other frames fall into the rests, and their draw is what is left",
    ),
    "drifting_clock": Fault(
        "a clock that runs 500 ppm fast", "clock drift", simulated="--mcs-drift-ppm 500",
    ),
    "board_late": Fault(
        "the board comes by a topic of its own, whose stamps are 12 ms late",
        "board: stamps -12", on_its_own(BOARD, "/tf_board", 12 * MS),
        config=lambda session, rig, targets: rig["mocap"].update(topics=["/tf", "/tf_board"]),
    ),
    "millimetres": Fault("positions in millimetres", "millimetres", transforms(millimetres)),
    "y_up": Fault("a map whose y axis points up", "", transforms(y_up)),
    "body_missing": Fault(
        "the cylinder was not tracked", "MCS body mocap/cylinder is not in the log",
        lost(CYLINDER),
    ),
    "robot_renamed": Fault(
        "the robot has another name than in the rig", "MCS body mocap/robot is not in the log",
        renamed("robot", "robot_1"),
    ),
    "no_mocap": Fault(
        "no motion capture in the log", "is not in the log",
        fault.without(lambda row, i: row[1] == POSES),
    ),
    "another_map": Fault(
        "poses in another frame than the rig's map", "which nothing connects to",
        transforms(in_another_map),
    ),
    "target_knocked": Fault(
        "markers of the cylinder are knocked by 22 mm half-way",
        "cylinder sits elsewhere in its MCS body from its placement 5", knocked,
    ),
}  # fmt: skip
