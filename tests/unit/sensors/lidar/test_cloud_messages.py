"""Messages of lidars as arrays, in the layouts that drivers really send, and what is inferred."""

import json
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.io.logs import ros_messages
from calib.io.logs.message_headers import header_stamp_ns
from calib.io.logs.message_types import MessageTypes
from calib.io.status import MessageError
from calib.sensors.lidar.clouds import cloud_messages, pointcloud2
from calib.sensors.lidar.clouds.cloud_layout import CloudLayout, infer_cloud_layout
from calib.sensors.lidar.clouds.cloud_messages import read_raw_cloud
from calib.sensors.lidar.clouds.point_time_inference import CloudSample
from calib.sensors.lidar.clouds.raw_cloud import make_raw_cloud, read_intensity
from simulation.ros_log import SPECIAL_CLOUD_MESSAGES, make_cloud_message
from simulation.sensors.cloud_formats import CLOUD_FORMATS, Echoes
from simulation.sensors.scan_patterns import SCAN_PATTERNS

CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}

# Layouts of drivers: field, type, offset; then the size of a point.
LAYOUTS = {
    "velodyne, packed": (
        [("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8)]
        + [("intensity", "f4", 12), ("ring", "u2", 16), ("time", "f4", 18)],
        22,
    ),
    "velodyne, padded by PCL": (
        [("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8)]
        + [("intensity", "f4", 16), ("ring", "u2", 20), ("time", "f4", 24)],
        32,
    ),
    "ouster": (
        [("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("intensity", "f4", 16), ("t", "u4", 20)]
        + [("reflectivity", "u2", 24), ("ring", "u2", 26), ("range", "u4", 32)],
        48,
    ),
    "ring of one byte": (
        [("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("ring", "u1", 12), ("t", "u4", 16)],
        20,
    ),
    "channel": ([("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("channel", "u2", 12)], 16),
    "line": ([("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("line", "u1", 12)], 16),
    "doubles, z first": ([("z", "f8", 0), ("y", "f8", 8), ("x", "f8", 16)], 24),
    "xyz alone": ([("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8)], 12),
}
SEC, NANOSEC = 1_700_000_000, 123_456_789
PERIOD = 100_000_000
XYZ = np.array([[1.5, -2.25, 0.125], [3, 4, -5], [-7, 0, 0], [0, 0, 9.5], [10, 11, 12], [1, 2, 3]])
RING = np.array([0, 15, 3, 7, 1, 127])
TIME_NS = np.array([0, 55_296, 1_000_000, 2_304, 99_999_744, 50_000_000])


def cloud(layout, xyz=XYZ, height=1, big=False, row_padding=0):
    """PointCloud2 of a layout, with rings and times where the layout has a place for them."""
    fields, step = LAYOUTS[layout]
    order = ">" if big else "<"
    dtype = np.dtype(
        {
            "names": [f[0] for f in fields],
            "formats": [order + f[1] for f in fields],
            "offsets": [f[2] for f in fields],
            "itemsize": step,
        }
    )
    points = np.zeros(len(xyz), dtype)
    noise = np.random.default_rng(0).integers(1, 255, points.nbytes, dtype=np.uint8)
    points = noise.view(dtype).copy()  # what lies between the fields is anything
    points["x"], points["y"], points["z"] = xyz.T
    for name in points.dtype.names:
        if name in ("ring", "channel", "line"):
            points[name] = RING[: len(xyz)]
        elif name == "time":
            points[name] = TIME_NS[: len(xyz)] / 1e9
        elif name == "t":
            points[name] = TIME_NS[: len(xyz)]
    width = len(xyz) // height
    rows = points.view(np.uint8).reshape(height, width * step)
    rows = np.pad(rows, ((0, 0), (0, row_padding)), constant_values=171)
    return SimpleNamespace(
        __msgtype__="sensor_msgs/msg/PointCloud2",
        header=SimpleNamespace(stamp=SimpleNamespace(sec=SEC, nanosec=NANOSEC), frame_id="lidar"),
        height=height,
        width=width,
        fields=[
            SimpleNamespace(name=n, datatype=CODES[t], offset=o, count=1) for n, t, o in fields
        ],
        is_bigendian=big,
        point_step=step,
        row_step=width * step + row_padding,
        data=rows.reshape(-1),
    )


def heard(*messages, asked=None):
    """The Layout, words and status of messages, each recorded a little after its scan's end."""
    samples = [
        CloudSample(read_raw_cloud(m), header_stamp_ns(m) + PERIOD + 2_000_000) for m in messages
    ]
    return infer_cloud_layout([s for s in samples if len(s[0].grid_index[0])], PERIOD, asked or {})


def points(message, layout):
    """xyz, ring and dt by what a whole cloud of that layout tells."""
    return cloud_messages.read_points(message, heard(cloud(layout))[0])[:3]


def has(layout, *names):
    return any(f[0] in names for f in LAYOUTS[layout][0])


# --- clouds


@pytest.mark.parametrize("big", [False, True], ids=["little-endian", "big-endian"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_points_rings_and_times_are_read_in_every_layout_and_byte_order(layout, big):
    xyz, ring, dt = points(cloud(layout, big=big), layout)
    assert xyz.dtype == np.float32 and xyz.dtype.isnative
    assert np.array_equal(xyz, XYZ)
    assert np.array_equal(ring, RING if has(layout, "ring", "channel", "line") else np.full(6, -1))
    assert dt.dtype == np.int64
    assert (
        np.abs(dt - (TIME_NS if has(layout, "t", "time") else 0)).max() <= 4
    )  # of float32 seconds


@pytest.mark.parametrize("height, row_padding", [(1, 0), (2, 0), (3, 0), (6, 0), (2, 10), (1, 7)])
def test_an_organised_cloud_is_read_row_by_row_without_the_padding_of_its_rows(height, row_padding):
    message = cloud("velodyne, packed", height=height, row_padding=row_padding)
    xyz, ring, _ = points(message, "velodyne, packed")
    assert np.array_equal(xyz, XYZ) and np.array_equal(ring, RING)


def test_beams_without_a_return_are_left_out_be_they_zeros_or_not_numbers():
    xyz = XYZ.copy()
    xyz[0], xyz[2], xyz[3, 1], xyz[4, 2] = 0, np.nan, np.nan, np.inf
    found, ring, dt = points(cloud("velodyne, packed", xyz, height=2), "velodyne, packed")
    assert np.array_equal(found, XYZ[[1, 5]])
    assert np.array_equal(ring, RING[[1, 5]])
    assert np.abs(dt - TIME_NS[[1, 5]]).max() <= 4


def test_a_point_on_an_axis_is_no_missing_return():
    xyz = np.array([[0, 0, 1], [0, -1, 0], [1e-6, 0, 0.0]])
    assert len(points(cloud("xyz alone", xyz), "xyz alone")[0]) == 3


@pytest.mark.parametrize("layout", ["velodyne, packed", "ouster", "xyz alone"])
@pytest.mark.parametrize("height", [0, 1])
def test_a_cloud_of_no_point_has_no_point(layout, height):
    message = cloud(layout, XYZ[:0])
    message.height = height
    xyz, ring, dt = points(message, layout)
    assert xyz.shape == (0, 3) and ring.shape == (0,) and dt.shape == (0,)


def test_nanoseconds_of_four_bytes_are_read_beyond_two_seconds():
    message = cloud("ouster")
    message.data.reshape(-1, 48)[1, 20:24] = np.array([4_000_000_000], "<u4").view(np.uint8)
    assert points(message, "ouster")[2][1] == 4_000_000_000


def test_a_cloud_without_coordinates_is_refused_with_the_fields_it_has():
    message = cloud("velodyne, packed")
    message.fields = [f for f in message.fields if f.name != "z"]
    with pytest.raises(MessageError) as caught:
        read_raw_cloud(message)
    assert str(caught.value) == (
        "a cloud without x, y, z: its fields are x, y, intensity, ring, time"
    )


@pytest.mark.parametrize("name", ["range", "distance"])
def test_a_range_of_zero_is_no_return_whatever_the_coordinates_say(name):
    message = cloud("ouster")
    message.fields[-1].name = name
    message.data.reshape(-1, 48)[:, 32:36] = np.array([[1], [0], [5], [0], [2], [9]], "<u4").view(
        "u1"
    )
    assert np.array_equal(points(message, "ouster")[0], XYZ[[0, 2, 4, 5]])


def test_a_range_that_the_driver_does_not_fill_says_nothing():
    message = cloud("ouster")
    message.data.reshape(-1, 48)[:, 32:36] = 0
    assert len(points(message, "ouster")[0]) == 6


# --- what drivers publish: the same points, times and rings

STAMP = SEC * 10**9 + NANOSEC
ALL = [*CLOUD_FORMATS, *SPECIAL_CLOUD_MESSAGES]


def scan(number, columns=360, missing=0.1):
    """Echoes of a turn of 16 beams that are 2° apart, some without return, on a wall 2 to 9 m away;
    of one beam in the plane for a number of columns below 0."""
    firing = SCAN_PATTERNS["beams16"]._replace(n_columns=abs(columns))
    if columns < 0:
        firing = firing._replace(elevation_deg=(0.0,))
    firing = firing.make_firing(np.pi, 0)
    rng = np.random.default_rng(number)
    shape = firing.beam_directions.shape[:2]
    returned = rng.uniform(size=shape) > missing
    distance = np.where(returned, rng.uniform(2, 9, shape), 0.0)
    xyz = firing.beam_directions * distance[..., None]
    t = STAMP + number * PERIOD
    return Echoes(xyz, distance, 0 * distance, returned, firing.column_time_ns[:, None], t)


def recorded(driver, change=lambda m: m, columns=360):
    """Echoes and messages of ten scans of a driver; change is applied to each message."""
    echoes = [scan(i, columns) for i in range(10)]
    return echoes, [
        change(logged(make_cloud_message(e.stamp_ns, "lidar", driver, e))) for e in echoes
    ]


def logged(message):
    """A message as a log gives it."""
    name, types = message.__msgtype__, MessageTypes("a log")
    types.add_definition(
        name, "ros2msg", ros_messages.ROS2_TYPES.generate_msgdef(name, ros_version=2)[0]
    )
    data = bytearray(
        ros_messages.ROS2_TYPES.serialize_cdr(message, name)
    )  # one that tests may change
    return types.make_codec(name, "cdr").decode(data)


def in_order(*columns):
    order = np.lexsort([np.round(c, 3) for c in columns[0].T])
    return [c[order] for c in columns]


@pytest.mark.parametrize("driver", ALL)
def test_points_times_and_rings_of_every_driver_are_the_same(driver):
    """Of the clock: times to 300 ns, which float64 leaves of a second since 1970; of the scan: to
    10 ns, which float32 does; a LaserScan's by its float32 increment to 1 µs."""
    echoes, messages = recorded(driver, columns=-360 if driver == "laserscan" else 360)
    layout, words, status = heard(*messages)
    assert status.ok
    e, message = echoes[3], messages[3]
    xyz, ring, dt, _ = cloud_messages.read_points(message, layout)
    beam = np.broadcast_to(np.arange(e.distance_m.shape[1]), e.distance_m.shape)[e.has_return]
    after = np.broadcast_to(e.column_time_ns, e.distance_m.shape)[e.has_return]
    t = dt + header_stamp_ns(message) - e.stamp_ns
    expected, after, beam = in_order(e.xyz[e.has_return], after, beam)
    found, t, ring = in_order(xyz, t, ring)
    assert np.abs(found - expected).max() < 1e-5
    if driver == "plain":
        assert layout.point_time is None and (dt == 0).all()
    else:
        assert np.abs(t - after).max() < (1000 if driver == "laserscan" else 300)
    assert np.array_equal(ring, beam)


@pytest.mark.parametrize("driver", ALL)
def test_the_intensity_of_every_return_is_read_under_the_name_that_the_driver_gives_it(driver):
    """A LaserScan without intensities has none; a scene of one grey tells none."""
    echoes, messages = recorded(driver, columns=-360 if driver == "laserscan" else 360)
    e, message = echoes[3], messages[3]
    xyz, *_, intensity = cloud_messages.read_points(message, heard(*messages)[0])
    expected = np.round(np.broadcast_to(e.grey_level, e.distance_m.shape)[e.has_return] / 2)
    if driver == "laserscan" or np.ptp(expected) == 0:
        assert np.isnan(intensity).all()
    else:
        assert np.array_equal(
            *(in_order(p, i)[1] for p, i in ((e.xyz[e.has_return], expected), (xyz, intensity)))
        )


def test_a_field_of_intensities_that_holds_one_value_throughout_tells_none():
    fields = {name: np.ones(3) for name in ("x", "y", "z", "intensity")}
    cloud_of_ones = make_raw_cloud(0, fields | {"reflectivity": np.arange(3)}, (1, 3))
    assert np.array_equal(read_intensity(cloud_of_ones), [0, 1, 2])
    assert np.isnan(read_intensity(make_raw_cloud(0, fields, (1, 3)))).all()


WORDS = {
    "velodyne": "time (float32), s after the stamp: 0.0 to 100.0 ms, 100.0 ms from scan to scan",
    "velodyne_last": "time (float32), s after the stamp: -100.0 to 0.0 ms",
    "ouster": "t (uint32), ns after the stamp: 0.0 to ",
    "hesai": "timestamp (float64), s on the clock of the stamps: 0.0 to ",
    "robosense": "timestamp (float64), s on the clock of the stamps: 0.0 to ",
    "livox": "timestamp (float64), ns on the clock of the stamps: 0.0 to ",
    "livox_custom": "offset_time (int64), ns on the clock of the stamps: 0.0 to ",
    "nebula": "time_stamp (uint32), ns after the stamp: 0.0 to ",
    "nebula_legacy": "time_stamp (float64), s on the clock of the stamps: 0.0 to ",
    "sick": "t (uint32), ns after the stamp: 0.0 to ",
    "sick_split": "lidar_sec (uint32), ns on the clock of the stamps: 0.0 to ",
    "laserscan": "time_increment (float64), s after the stamp: 0.0 to ",
    "plain": "points have no time stamps (none of the fields x, y, z, intensity is a time): scans "
    "are used only while nothing moves",
}


@pytest.mark.parametrize("driver", ALL)
def test_the_audit_says_in_words_which_time_was_found(driver):
    _, messages = recorded(driver, columns=-360 if driver == "laserscan" else 360)
    assert heard(*messages)[1]["time"].startswith(WORDS[driver])


def test_a_layout_goes_through_json_and_back():
    for driver in ALL:
        layout = heard(*recorded(driver)[1])[0]
        assert CloudLayout.from_dict(json.loads(json.dumps(layout.to_dict()))) == layout


# --- times


def times_as(kind, make):
    """A change of messages of `sick`: its field ts of another type with make(dt in ns, stamp)."""

    def change(message):
        cloud = pointcloud2.read(message)
        dt = np.asarray(cloud.fields["t"], np.int64)
        made = make(dt, cloud.stamp_ns).astype(kind)
        points = message.data.reshape(-1, message.point_step)
        size = made.dtype.itemsize
        message.data = np.hstack([points, made.reshape(-1, 1).view("u1")]).reshape(-1)
        named = {f.name: f for f in message.fields}
        named["ts"].name, named["ts"].datatype = "stamps", CODES[made.dtype.str[1:]]
        named["ts"].offset = message.point_step
        message.fields = [f for f in message.fields if f.name != "t"]
        message.point_step += size
        message.row_step = message.width * message.point_step
        return message

    return change


@pytest.mark.parametrize(
    "kind, make, unit, origin",
    [
        ("f4", lambda dt, t: dt / 1e9, "s", "stamp"),
        ("f4", lambda dt, t: dt / 1e6, "ms", "stamp"),
        ("f8", lambda dt, t: dt / 1e3, "us", "stamp"),
        ("u4", lambda dt, t: dt / 1e3, "us", "stamp"),
        ("u4", lambda dt, t: dt, "ns", "stamp"),
        ("i4", lambda dt, t: dt - 100_000_000, "ns", "stamp"),
        ("f8", lambda dt, t: (t + dt) / 1e9, "s", "clock"),
        ("f8", lambda dt, t: (t + dt) / 1e6, "ms", "clock"),
        ("f8", lambda dt, t: (t + dt) / 1e3, "us", "clock"),
        ("f8", lambda dt, t: t + dt, "ns", "clock"),
        ("f8", lambda dt, t: (t + dt) / 1e9 + 37, "s", "first"),
        ("f8", lambda dt, t: (t + dt) / 1e9 - 1.699e9, "s", "first"),
        ("u4", lambda dt, t: (t + dt) // 1000 % 2**31, "us", "first"),
    ],
)
def test_unit_and_origin_of_times_show_by_how_they_grow(kind, make, unit, origin):
    echoes, messages = recorded("sick", times_as(kind, make))
    layout, words, _ = heard(*messages)
    assert (layout.point_time.field, layout.point_time.unit, layout.point_time.origin) == (
        "stamps",
        unit,
        origin,
    )
    assert "doubtful" not in words["time"]
    dt = cloud_messages.read_points(messages[3], layout)[2]
    shift = -100_000_000 if kind == "i4" else 0
    true = np.broadcast_to(echoes[3].column_time_ns, echoes[3].has_return.shape)[
        echoes[3].has_return
    ]
    assert np.abs(np.sort(dt) - np.sort(true) - shift).max() < 5000


@pytest.mark.parametrize("apart_s", [3, 1000])
@pytest.mark.parametrize("driver", ["velodyne", "ouster", "hesai", "livox"])
def test_times_of_a_log_with_few_of_the_clouds_are_those_of_the_driver(driver, apart_s):
    """A cloud in 3 s or in 1000 s, as of a topic that was thinned out."""
    echoes = [scan(i)._replace(stamp_ns=STAMP + i * apart_s * 10**9) for i in range(3)]
    samples = [
        CloudSample(
            read_raw_cloud(make_cloud_message(e.stamp_ns, "lidar", driver, e)), e.stamp_ns + PERIOD
        )
        for e in echoes
    ]
    layout, words, _ = infer_cloud_layout(samples, apart_s * 10**9, {})
    assert layout.point_time == heard(*recorded(driver)[1])[0].point_time
    assert layout.period_ns == 0 and "from scan to scan" not in words["time"]


def test_a_cloud_without_times_counts_for_a_scan_to_both_sides_of_its_stamp():
    layout = heard(*recorded("plain")[1])[0]
    assert layout.time_span_ns(np.zeros(5, int)) == (-PERIOD, PERIOD)
    samples = [CloudSample(read_raw_cloud(m), header_stamp_ns(m)) for m in recorded("plain")[1]]
    assert infer_cloud_layout(samples, 3 * 10**9, {})[0].time_span_ns(None) == (
        -200_000_000,
        200_000_000,
    )


def test_a_lidar_clock_on_tai_is_named():
    _, messages = recorded("sick", times_as("f8", lambda dt, t: (t + dt) / 1e9 + 37))
    words = heard(*messages)[1]["time"]
    assert "that clock is +37.000 s from the stamps: TAI for UTC, set the driver's offset" in words


def test_a_stamp_that_the_log_took_at_once_is_that_of_the_last_point():
    _, messages = recorded("sick", times_as("f8", lambda dt, t: (t + dt) / 1e9 + 5000))
    samples = [CloudSample(read_raw_cloud(m), header_stamp_ns(m) + 3_000_000) for m in messages]
    layout, _, _ = infer_cloud_layout(samples, PERIOD, {})
    assert layout.point_time.origin == "last"
    dt = cloud_messages.read_points(messages[0], layout)[2]
    assert dt.max() == 0 and dt.min() == pytest.approx(-99_700_000, abs=1e6)


def test_points_that_the_log_took_before_they_were_measured_are_doubted_in_words():
    _, messages = recorded("ouster")
    samples = [CloudSample(read_raw_cloud(m), header_stamp_ns(m) + 3_000_000) for m in messages]
    words = infer_cloud_layout(samples, PERIOD, {})[1]["time"]
    assert "doubtful: the last points lie 97 ms after the log recorded them" in words
    assert "write point_time: {origin: last}" in words


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda dt, t: 0 * dt, "stamps (float32) spans 0 in a scan, no time of 100 ms"),
        (lambda dt, t: (t + dt) / 1e9, "stamps (float32) spans 0 in a scan, no time of 100 ms"),
        (lambda dt, t: dt * 20, "stamps (float32) spans 2e+09 in a scan, no time of 100 ms"),
        (
            lambda dt, t: np.where(dt > 5e7, np.nan, dt),
            "stamps (float32) has values that are not finite",
        ),
    ],
)
def test_values_that_are_no_times_are_named_and_not_used(make, words):
    """Among them seconds since 1970, of which float32 leaves steps of 128 s."""
    layout, told, status = heard(*recorded("sick", times_as("f4", make))[1])
    assert layout.point_time is None and status.ok and words in told["time"]


def test_point_time_of_the_rig_is_obeyed():
    echoes, messages = recorded("ouster")
    asked = {"origin": "last"}
    layout, words, _ = heard(*messages, asked=asked)
    assert layout.point_time.unit == "ns" and layout.point_time.origin == "last"
    assert "(point_time)" in words["time"]
    assert cloud_messages.read_points(messages[0], layout)[2].max() == 0
    asked = {"field": "ts", "unit": "s", "origin": "stamp"}
    assert heard(*recorded("sick")[1], asked=asked)[0].point_time.field == "ts"


def test_a_point_time_that_no_scan_takes_is_obeyed_and_doubted():
    words = heard(*recorded("velodyne")[1], asked={"unit": "ms"})
    assert words[0].point_time.unit == "ms"
    words = heard(*recorded("ouster")[1], asked={"unit": "us"})[1]["time"]
    assert "doubtful: no scan takes that long; see point_time" in words


def test_a_point_time_of_a_field_that_is_not_there_fails_with_those_that_are():
    _, _, status = heard(*recorded("velodyne")[1], asked={"field": "stamp"})
    assert status.reason == "point_time does not fit the clouds"
    assert status.found == "no field stamp: there are x, y, z, intensity, ring, time"
    assert status.expected == "field stamp"


def test_a_cloud_whose_times_lie_far_from_its_stamp_is_not_read():
    message = cloud("velodyne, packed")
    message.data.reshape(-1, 22)[2, 18:22] = np.array([3000], "<f4").view(np.uint8)
    with pytest.raises(MessageError, match="points 3000.0 s from the stamp of their scan"):
        points(message, "velodyne, packed")


def test_a_cloud_without_the_time_of_the_others_is_not_read():
    with pytest.raises(MessageError, match="a cloud without its time, time: its fields are x, y"):
        points(cloud("xyz alone"), "velodyne, packed")


# --- rings


@pytest.mark.parametrize("driver", ["robosense", "ouster"])
def test_rows_of_an_organised_cloud_are_its_beams_where_no_field_is(driver):
    def ringless(message):
        message.fields = [f for f in message.fields if f.name != "ring"]
        return message

    echoes, messages = recorded(driver, ringless)
    layout, words, _ = heard(*messages)
    assert words["ring"] == "no ring, inferred: each row is one beam"
    ring = cloud_messages.read_points(messages[0], layout)[1]
    assert np.array_equal(np.bincount(ring), echoes[0].has_return.sum(0))


def test_beams_are_told_by_their_elevation_where_no_field_is():
    words = heard(*recorded("plain")[1])[1]["ring"]
    assert words == "no ring, inferred: 16 beams, -15.00 to 15.00° high"


def test_a_ring_that_is_never_filled_is_inferred():
    def unfilled(message):
        message.data.reshape(-1, 22)[:, 16:18] = 0
        return message

    layout, words, _ = heard(*recorded("velodyne", unfilled)[1])
    assert len(layout.beams.elevation_deg) == 16
    assert words["ring"].startswith(
        "ring (uint16) does not number the beams: it has 1 values, inferred"
    )


def test_lines_that_sweep_up_and_down_are_no_rings_and_what_that_costs_is_said():
    rosette = SCAN_PATTERNS["rosette"]
    messages = []
    for i in range(10):
        firing, t = rosette.make_firing(np.radians(35), i), STAMP + i * PERIOD
        distance = np.full(firing.beam_directions.shape[:2], 5.0)
        seen = Echoes(5 * firing.beam_directions, distance, distance, distance > 0,
                              firing.column_time_ns[:, None], t)  # fmt: skip
        messages.append(make_cloud_message(t, "lidar", "livox", seen))
    layout, words, _ = heard(*messages)
    assert layout.beams is None
    assert words["ring"].startswith("the 6 lines of line (uint8) sweep up and down, and the points")
    assert "a board's outline is not used, only its plane" in words["ring"]
    assert (cloud_messages.read_points(messages[0], layout)[1] == -1).all()


def test_a_scanner_of_one_line_is_called_so():
    words = heard(*recorded("laserscan", columns=-360)[1])[1]["ring"]
    assert words == "a 2-D scanner: one line, with little information across it"


# --- other messages


def test_points_of_foxglove_are_brought_into_the_frame_of_the_message():
    message = cloud("velodyne, packed")
    names = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}  # INT8 and UINT8 are the other way
    fields = [SimpleNamespace(name=f.name, offset=f.offset, type=names[f.datatype])
              for f in message.fields]  # fmt: skip
    half = np.sqrt(0.5)
    pose = SimpleNamespace(
        position=SimpleNamespace(x=1.0, y=2.0, z=3.0),
        orientation=SimpleNamespace(x=0.0, y=0.0, z=half, w=half),
    )
    stamp = SimpleNamespace(sec=SEC, nanosec=NANOSEC)
    given = SimpleNamespace(
        __msgtype__="foxglove_msgs/msg/PointCloud", timestamp=stamp, frame_id="lidar", pose=pose,
        point_stride=22, fields=fields, data=message.data,
    )  # fmt: skip
    xyz, ring, dt = points(given, "velodyne, packed")
    turned = np.column_stack([-XYZ[:, 1], XYZ[:, 0], XYZ[:, 2]]) + [1, 2, 3]
    assert np.abs(xyz - turned).max() < 1e-5
    assert np.array_equal(ring, RING) and np.abs(dt - TIME_NS).max() <= 4
    pose.orientation.w = pose.orientation.z = 0.0
    assert np.abs(points(given, "velodyne, packed")[0] - XYZ - [1, 2, 3]).max() < 1e-5

    pose.position.x = np.nan
    with pytest.raises(MessageError, match="a cloud whose pose is not finite"):
        read_raw_cloud(given)


# --- hostile input


@pytest.mark.parametrize(
    "change, words",
    [
        ({"width": 10**9}, "a cloud of 1 x 1000000000 points of 22 bytes takes 22000000000 bytes"),
        ({"height": 2**32 - 1}, "takes 566935682940 bytes and has 132; the message is damaged"),
        ({"point_step": 2**31}, "a cloud of points of 2147483648 bytes; the message is damaged"),
        ({"point_step": 0}, "a cloud whose x does not fit into its points of 0 bytes"),
        ({"point_step": 11}, "a cloud whose z does not fit into its points of 11 bytes"),
        ({"data": np.zeros(131, np.uint8)}, "takes 132 bytes and has 131; the message is damaged"),
        ({"height": 3, "width": 2, "row_step": 1000}, "takes 2044 bytes and has 132"),
    ],
)
def test_sizes_that_the_data_do_not_hold_are_refused_before_memory_is_taken(change, words):
    message = cloud("velodyne, packed")
    vars(message).update(change)
    tracemalloc.start()
    with pytest.raises(MessageError) as caught:
        read_raw_cloud(message)
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert words in str(caught.value)
    assert taken < 1e6


NUMBERS = st.one_of(st.integers(0, 300), st.sampled_from([2**31, 2**32 - 1]))


@settings(max_examples=300, deadline=None)
@given(
    st.fixed_dictionaries(
        {}, optional={k: NUMBERS for k in ("height", "width", "point_step", "row_step")}
    ),
    st.binary(max_size=400),
    st.lists(st.tuples(st.sampled_from(["x", "y", "z", "ring", "time", ""]), NUMBERS,
                       st.integers(0, 255)), max_size=8),
    st.booleans(),
)  # fmt: skip
def test_any_header_gives_points_or_one_clean_error(sizes, data, fields, big):
    message = cloud("velodyne, packed")
    vars(message).update(sizes, is_bigendian=big)
    if data:
        message.data = np.frombuffer(data, np.uint8)
    if fields:
        named = [SimpleNamespace(name=n, offset=o, datatype=t, count=1) for n, o, t in fields]
        message.fields = [*named, *message.fields[:3]]
    layout = heard(cloud("velodyne, packed"))[0]
    try:
        xyz, ring, dt, _ = cloud_messages.read_points(message, layout)
    except MessageError:
        return
    assert len(xyz) == len(ring) == len(dt) and np.isfinite(xyz).all()
    if len(xyz):
        heard(message)
