"""Long lists of small structures, read as one array."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from calib.io.logs import ros_messages
from calib.io.logs.message_types import MessageTypes
from calib.io.logs.ros_messages import LIVOX_TYPE
from calib.io.status import InputError
from helpers.log_containers import make_ros2_message

NAME, POINT = LIVOX_TYPE, "livox_ros_driver2/msg/CustomPoint"
STORES = {"cdr": ros_messages.ROS2_TYPES, "ros1": get_typestore(Stores.ROS1_NOETIC)}
STORES["ros1"].register({k: ros_messages.ROS2_TYPES.fielddefs[k] for k in (NAME, POINT)})
FIELDS = ("offset_time", "x", "y", "z", "reflectivity", "tag", "line")


def message(n, frame="livox"):
    """CustomMsg of ROS 2 with n points, as objects."""
    rng = np.random.default_rng(n)
    xyz = rng.normal(0, 9, (n, 3)).astype(np.float32).tolist()
    whole = rng.integers(0, 2**32, n).tolist(), rng.integers(0, 256, (n, 3)).tolist()
    points = [
        ros_messages.ROS2_TYPES.types[POINT](**dict(zip(FIELDS, (t, *p, *small), strict=True)))
        for p, t, small in zip(xyz, *whole, strict=True)
    ]
    stamp = make_ros2_message("builtin_interfaces/msg/Time", sec=1_700_000_000, nanosec=123_456_789)
    header = make_ros2_message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)
    return ros_messages.ROS2_TYPES.types[NAME](
        header=header, timebase=2**63 + 5, point_num=n, lidar_id=7,
        rsvd=np.arange(3, dtype=np.uint8), points=points,
    )  # fmt: skip


def serialised(found, form):
    """Bytes of a message: CDR of either byte order, or ROS 1."""
    if form != "ros1":
        little = form == "cdr, little-endian"
        return bytes(ros_messages.ROS2_TYPES.serialize_cdr(found, NAME, little_endian=little))
    types = STORES["ros1"].types
    header = types["std_msgs/msg/Header"](
        seq=3, stamp=found.header.stamp, frame_id=found.header.frame_id
    )
    fields = vars(found) | {"header": header}
    fields.pop("__msgtype__", None)
    return bytes(STORES["ros1"].serialize_ros1(types[NAME](**fields), NAME))


def codec(form, change=lambda text: text):
    """The Codec of a log that defines CustomMsg; change: of the definition."""
    types, one = MessageTypes("a log"), form == "ros1"
    text, _ = STORES["ros1" if one else "cdr"].generate_msgdef(NAME, ros_version=1 if one else 2)
    types.add_definition(NAME, "ros1msg" if one else "ros2msg", change(text))
    return types.make_codec(NAME, "ros1" if one else "cdr")


FORMS = ["cdr, little-endian", "cdr, big-endian", "ros1"]


@pytest.mark.parametrize("form", FORMS)
@given(n=st.integers(0, 40), frame=st.text("abc", max_size=9))
@settings(max_examples=40, deadline=None)
def test_points_of_a_livox_message_are_those_that_were_written(form, n, frame):
    """Whatever precedes them, for CDR aligns them to four bytes."""
    written = message(n, frame)
    found = codec(form).decode(serialised(written, form))
    assert (found.header.frame_id, found.timebase, found.point_num) == (frame, 2**63 + 5, n)
    assert found.points.shape == (n,)
    for field in FIELDS:
        assert found.points[field].tolist() == [getattr(p, field) for p in written.points]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("change", [lambda d: d[:-9], lambda d: d + bytes(20), lambda d: d[:30]])
def test_a_message_of_another_length_than_its_points_is_refused(form, change):
    with pytest.raises(InputError, match="CustomMsg cannot be read"):
        codec(form).decode(change(serialised(message(5), form)))


def test_points_of_another_layout_are_refused_by_name():
    wide = codec("cdr", lambda text: text.replace("uint8 line", "uint16 line"))
    with pytest.raises(InputError, match="CustomPoint has other fields than those of its driver"):
        wide.decode(serialised(message(5), FORMS[0]))


def test_a_scan_of_24000_points_takes_a_fifth_of_the_time_that_objects_take_or_less():
    """1 ms instead of 30."""
    data, read = serialised(message(24_000), FORMS[0]), codec(FORMS[0])

    def fastest(function):
        times = []
        for _ in range(3):
            begin = time.process_time()
            function()
            times.append(time.process_time() - begin)
        return min(times)

    objects = fastest(lambda: ros_messages.ROS2_TYPES.deserialize_cdr(data, NAME))
    assert fastest(lambda: read.decode(data)) < objects / 5
