"""Faults of lidars."""

import numpy as np

import containers
import fault
from fault import CLOUDS, Fault, S, clouds, put, repacked

XYZ = dict.fromkeys("xyz", "f4")
VELODYNE = XYZ | {"intensity": "f4", "ring": "u2", "time": "f4"}


def time_as(kind, scale, shift=0.0):
    """A damage that gives the times of points in another type, unit and from another begin."""

    def change(array, number):
        out = repacked(array, VELODYNE | {"time": kind})
        out["time"] = np.round(scale * (array["time"].astype(float) + shift), 6)
        return out

    return clouds(change)


def on_a_clock(ahead_s):
    """A damage that gives times on a clock that is so far ahead of the stamps'."""

    def of_message(message, number):
        array = fault.points(message)
        kept = {k: v for k, v in VELODYNE.items() if k != "time"}
        wide = np.zeros(len(array), [*kept.items(), ("timestamp", "f8")])
        for name in kept:
            wide[name] = array[name]
        wide["timestamp"] = (
            fault.stamp_ns(message.header) / S + ahead_s + array["time"].astype(float)
        )
        put(message, wide)

    return fault.on(CLOUDS, of_message)


def stamped_at_end(message, number):
    """The stamp of the last point, and times still counted from the first."""
    fault.set_stamp(message.header, fault.stamp_ns(message.header) + S // 10)


def with_nothing(value):
    """A damage that adds as many beams without a return as there are points."""

    def change(array, number):
        none = array.copy()
        for axis in "xyz":
            none[axis] = value
        return np.stack([array, none], 1).reshape(-1)

    return clouds(change)


def organised(message, number):
    """Beams by columns, as Ouster's: NaN where there is no return."""
    array = fault.points(message)
    beams = int(array["ring"].max()) + 1
    column = np.cumsum(np.diff(array["ring"].astype(int), prepend=array["ring"][:1]) < 0)
    grid = np.zeros((beams, int(column.max()) + 1), array.dtype)
    for axis in "xyz":
        grid[axis] = np.nan
    grid["ring"] = np.arange(beams)[:, None]
    grid[array["ring"], column] = array
    put(message, grid.reshape(-1), beams)


def big_endian(message, number):
    put(message, repacked(fault.points(message), VELODYNE, order=">"))
    message.is_bigendian = True


def empty(message, number):
    if number % 3 == 1:
        put(message, fault.points(message)[:0])


def claims_too_much(message, number):
    if number % 4 == 3:
        message.width *= 1000


def packets(rows):
    """What the lidar sends in place of every cloud."""
    kind = "velodyne_msgs/msg/VelodyneScan"
    return [
        (t, topic, kind, containers.make(kind, header=message.header, packets=[]))
        if topic == CLOUDS
        else (t, topic, known, message)
        for t, topic, known, message in rows
    ]


def moved_into_body(array, number):
    """Points that a driver has moved by 0.2 m and turned by 30°, as into base_link."""
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    x, y = array["x"].copy(), array["y"].copy()
    array["x"], array["y"] = c * x - s * y + 0.2, s * x + c * y
    return array


def without(*names):
    left = {k: v for k, v in VELODYNE.items() if k not in names}
    return clouds(lambda array, number: repacked(array, left))


LIDAR = {
    "no_ring": Fault("no field for the ring", "velodyne: ring", without("ring")),
    "no_time": Fault(
        "no field for the time of a point", "velodyne: time", without("time"),
        note="Fewer than half of the scans count, and none in motion",
    ),
    "time_in_us": Fault(
        "times in microseconds, as 32-bit floats", "velodyne: time", time_as("f4", 1e6),
    ),
    "stamp_at_end": Fault(
        "stamps of the scan's end, but times from its begin", "velodyne: time",
        fault.on(CLOUDS, stamped_at_end),
    ),
    "time_tai": Fault(
        "times of points in TAI, 37 s ahead of the stamps", "velodyne: time", on_a_clock(37.0),
    ),
    "nothing_nan": Fault("beams without a return as NaN", "", with_nothing(np.nan)),
    "organised": Fault("an organised cloud", "", fault.on(CLOUDS, organised)),
    "big_endian": Fault("a big-endian cloud", "", fault.on(CLOUDS, big_endian)),
    "half_the_scans": Fault(
        "every second scan is missing", "velodyne",
        fault.without(lambda row, i: row[1] == CLOUDS and i % 2 == 1),
    ),
    "empty_clouds": Fault("every third cloud is empty", "velodyne", fault.on(CLOUDS, empty)),
    "damaged_clouds": Fault(
        "every fourth cloud claims a thousand times its points", "the message is damaged",
        fault.on(CLOUDS, claims_too_much),
    ),
    "packets": Fault("the lidar's packets in place of clouds", "packets", packets),
    "cloud_in_body_frame": Fault(
        "a cloud that the driver has moved into the robot's frame", "first guess",
        clouds(moved_into_body),
        note="What is found is the pose of the frame that the cloud is in",
    ),
}  # fmt: skip
