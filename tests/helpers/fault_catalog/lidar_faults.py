"""Faults of lidars."""

import numpy as np

from calib.geometry.units import NS_PER_S
from helpers.fault_catalog.fault_case import (
    CLOUD_TOPIC,
    FaultCase,
    damage_clouds,
    damage_topic,
    drop_rows,
    read_cloud_points,
    read_header_stamp,
    repack_points,
    set_cloud_points,
    set_header_stamp,
)
from helpers.log_containers import make_ros2_message

XYZ_FIELDS = dict.fromkeys("xyz", "f4")
VELODYNE_FIELDS = XYZ_FIELDS | {"intensity": "f4", "ring": "u2", "time": "f4"}


def convert_point_times(number_type, scale, shift_s=0.0):
    """A damage that gives the times of points in another type, unit and from another begin."""

    def change(array, number):
        out = repack_points(array, VELODYNE_FIELDS | {"time": number_type})
        out["time"] = np.round(scale * (array["time"].astype(float) + shift_s), 6)
        return out

    return damage_clouds(change)


def use_another_clock(ahead_s):
    """A damage that gives times on a clock that is so far ahead of the stamps'."""

    def of_message(message, number):
        array = read_cloud_points(message)
        kept = {k: v for k, v in VELODYNE_FIELDS.items() if k != "time"}
        wide = np.zeros(len(array), [*kept.items(), ("timestamp", "f8")])
        for name in kept:
            wide[name] = array[name]
        wide["timestamp"] = (
            read_header_stamp(message.header) / NS_PER_S + ahead_s + array["time"].astype(float)
        )
        set_cloud_points(message, wide)

    return damage_topic(CLOUD_TOPIC, of_message)


def stamp_scan_end(message, number):
    """The stamp of the last point, and times still counted from the first."""
    set_header_stamp(message.header, read_header_stamp(message.header) + NS_PER_S // 10)


def add_missing_returns(no_return_value):
    """A damage that adds as many beams without a return as there are points."""

    def change(array, number):
        none = array.copy()
        for axis in "xyz":
            none[axis] = no_return_value
        return np.stack([array, none], 1).reshape(-1)

    return damage_clouds(change)


def organize_cloud(message, number):
    """Beams by columns, as Ouster's: NaN where there is no return."""
    array = read_cloud_points(message)
    beams = int(array["ring"].max()) + 1
    column = np.cumsum(np.diff(array["ring"].astype(int), prepend=array["ring"][:1]) < 0)
    grid = np.zeros((beams, int(column.max()) + 1), array.dtype)
    for axis in "xyz":
        grid[axis] = np.nan
    grid["ring"] = np.arange(beams)[:, None]
    grid[array["ring"], column] = array
    set_cloud_points(message, grid.reshape(-1), beams)


def make_big_endian(message, number):
    set_cloud_points(
        message, repack_points(read_cloud_points(message), VELODYNE_FIELDS, byte_order=">")
    )
    message.is_bigendian = True


def empty_every_third(message, number):
    if number % 3 == 1:
        set_cloud_points(message, read_cloud_points(message)[:0])


def inflate_cloud_width(message, number):
    if number % 4 == 3:
        message.width *= 1000


def send_packets(rows):
    """What the lidar sends in place of every cloud."""
    kind = "velodyne_msgs/msg/VelodyneScan"
    return [
        (t, topic, kind, make_ros2_message(kind, header=message.header, packets=[]))
        if topic == CLOUD_TOPIC
        else (t, topic, known, message)
        for t, topic, known, message in rows
    ]


def transform_into_body(array, number):
    """Points that a driver has moved by 0.2 m and turned by 30°, as into base_link."""
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    x, y = array["x"].copy(), array["y"].copy()
    array["x"], array["y"] = c * x - s * y + 0.2, s * x + c * y
    return array


def drop_point_fields(*field_names):
    left = {k: v for k, v in VELODYNE_FIELDS.items() if k not in field_names}
    return damage_clouds(lambda array, number: repack_points(array, left))


LIDAR_FAULTS = {
    "no_ring": FaultCase("no field for the ring", "velodyne: ring", drop_point_fields("ring")),
    "no_time": FaultCase(
        "no field for the time of a point",
        "velodyne: time",
        drop_point_fields("time"),
        note="Fewer than half of the scans count, and none in motion",
    ),
    "time_in_us": FaultCase(
        "times in microseconds, as 32-bit floats",
        "velodyne: time",
        convert_point_times("f4", 1e6),
    ),
    "stamp_at_end": FaultCase(
        "stamps of the scan's end, but times from its begin",
        "velodyne: time",
        damage_topic(CLOUD_TOPIC, stamp_scan_end),
    ),
    "time_tai": FaultCase(
        "times of points in TAI, 37 s ahead of the stamps",
        "velodyne: time",
        use_another_clock(37.0),
    ),
    "nothing_nan": FaultCase("beams without a return as NaN", "", add_missing_returns(np.nan)),
    "organised": FaultCase("an organised cloud", "", damage_topic(CLOUD_TOPIC, organize_cloud)),
    "big_endian": FaultCase("a big-endian cloud", "", damage_topic(CLOUD_TOPIC, make_big_endian)),
    "half_the_scans": FaultCase(
        "every second scan is missing",
        "velodyne",
        drop_rows(lambda row, i: row[1] == CLOUD_TOPIC and i % 2 == 1),
    ),
    "empty_clouds": FaultCase(
        "every third cloud is empty", "velodyne", damage_topic(CLOUD_TOPIC, empty_every_third)
    ),
    "damaged_clouds": FaultCase(
        "every fourth cloud claims a thousand times its points",
        "the message is damaged",
        damage_topic(CLOUD_TOPIC, inflate_cloud_width),
    ),
    "packets": FaultCase("the lidar's packets in place of clouds", "packets", send_packets),
    "cloud_in_body_frame": FaultCase(
        "a cloud that the driver has moved into the robot's frame",
        "initial guess",
        damage_clouds(transform_into_body),
        note="What is found is the pose of the frame that the cloud is in",
    ),
}
