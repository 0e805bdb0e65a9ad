"""Damaged logs: whatever byte is wrong or missing, decode ends with a result or one clear line."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarking.fuzzing.byte_damage import BYTE_DAMAGES
from benchmarking.fuzzing.case_runner import limit_time
from calib.decoding.sensor_probe import LidarProbe
from calib.io.logs.open_log import open_log
from calib.io.logs.ros_messages import IMAGE_TYPE
from calib.io.status import InputError, MessageError
from calib.sensors.camera.images.image_messages import read_bgr
from calib.sensors.lidar.clouds.cloud_messages import read_raw_cloud
from helpers.log_containers import (
    CONTAINER_START_NS,
    container_decode_options,
    decode_tables,
    make_container_rows,
    make_ros2_message,
    make_small_cloud,
    make_small_image,
    serialize_cdr,
    write_in_container,
    write_test_mcap,
)

KIND = "TFMessage"
CASES = int(os.environ.get("DAMAGED_COPIES", "45"))  # of each container
SECONDS = 20  # of one case; they take about 20 ms
DAMAGED = [
    "mcap, zstd", "mcap, lz4", "mcap, none", "mcap, no chunks", "mcap, ros1", "rosbag2, mcap, file",
    "rosbag2, sqlite3", "rosbag2, sqlite3, message", "bag", "bag, bz2", "bag, lz4",
]  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """{container: (log as config.yaml names it, the file that holds its messages, its bytes)}."""
    out = {}
    for container in DAMAGED:
        folder = tmp_path_factory.mktemp("log")
        log = write_in_container(container, folder, make_container_rows(KIND))
        path = Path(log)
        if path.is_dir():
            (path,) = (p for p in path.iterdir() if p.name != "metadata.yaml")
        out[container] = log, path, path.read_bytes()
    return out


def outcome(log):
    """Number of poses and frames that decode takes from a log, and what it says of its faults; or
    the line in which it refuses. What is found can be read again, or not, in a line."""
    try:
        poses, frames, audit = decode_tables(log, container_decode_options(KIND))
    except InputError as error:
        return str(error)
    again = open_log(log)
    for row in range(0, len(frames["stamp_ns"]), 5):
        place = [int(frames[k][row]) for k in ("file_index", "log_time_ns", "index_at_log_time")]
        topic = {"camera": "/image", "lidar": "/points"}[str(frames["sensor"][row])]
        try:
            again.read_message_content(topic, *place)
        except InputError as error:
            assert "\n" not in str(error)
    return len(poses["stamp_ns"]), len(frames["stamp_ns"]), audit["faults"]


@pytest.mark.parametrize("container", DAMAGED)
def test_a_damaged_log_gives_what_is_left_of_it_or_one_clear_line(whole, container):
    log, path, content = whole[container]
    rng = np.random.default_rng(DAMAGED.index(container))
    read = 0
    try:
        for case in range(CASES):
            damage = BYTE_DAMAGES[case % len(BYTE_DAMAGES)]
            path.write_bytes(damage(bytearray(content), rng))
            with limit_time(SECONDS):
                found = outcome(log)
            if isinstance(found, str):
                assert "\n" not in found and path.name.split(".")[0] in found
            else:
                poses, frames, faults = found
                read += bool(poses)
                assert poses <= 40 + 2 and frames <= 14 + 2
                assert all("\n" not in fault for fault in faults)
    finally:
        path.write_bytes(content)
    # A small file compressed as a whole is one block, of which a part gives nothing: of five kinds
    # of damage only two leave it readable, and seldom.
    assert read > CASES / (30 if container.endswith("file") else 10)


@pytest.mark.parametrize("container", ["mcap, zstd", "mcap, none", "mcap, no chunks"])
def test_what_a_cut_mcap_still_holds_grows_with_every_byte(whole, container):
    log, path, content = whole[container]
    counts = []
    try:
        for size in np.linspace(0, len(content), 25, dtype=int):
            path.write_bytes(content[:size])
            found = outcome(log)
            counts.append(0 if isinstance(found, str) else found[0])
            assert size == len(content) or isinstance(found, str) or found[2]
    finally:
        path.write_bytes(content)
    assert counts == sorted(counts) and counts[0] == 0 and counts[-1] == 40


def test_a_message_whose_payload_is_cut_is_a_fault_of_its_own(tmp_path):
    """Its header tells of a frame, so that crop will ask for it; the others must not suffer."""
    rows = make_container_rows(KIND)
    third = [m for _, topic, _, m in rows if topic == "/image"][2]

    def serialise(name, message):
        return serialize_cdr(name, message)[: -10 if message is third else None]

    log = str(write_test_mcap(tmp_path / "a.mcap", rows, serialise))
    _, frames, _ = decode_tables(log, container_decode_options(KIND))
    again, read = open_log(log), 0
    for row in np.flatnonzero(frames["sensor"] == "camera"):
        place = [int(frames[k][row]) for k in ("file_index", "log_time_ns", "index_at_log_time")]
        try:
            read += again.read_message_content("/image", *place).height == 2
        except MessageError as error:
            assert "sensor_msgs/msg/Image cannot be read" in str(error) and row == 2
    assert read == 6


def test_a_cloud_with_other_fields_hides_nothing_of_the_rest():
    heard = LidarProbe({})
    for i in range(5):
        cloud = make_small_cloud(CONTAINER_START_NS + i * 10**8)
        if i == 0:
            field = make_ros2_message("sensor_msgs/msg/PointField", name="ring", offset=4,
                                    datatype=4, count=1)  # fmt: skip
            cloud.fields.append(field)
        log_time_ns = CONTAINER_START_NS + i * 10**8
        heard.add_message(SimpleNamespace(content=cloud, log_time_ns=log_time_ns))
    told, status = heard.audit(10**8, {})
    assert status.ok and "no ring" in told["inferred"]["ring"]


def test_a_message_that_is_not_defined_as_ros_does_it_is_a_fault_of_its_own():
    for module, kind in (
        (read_raw_cloud, "sensor_msgs/msg/LaserScan"),
        (read_bgr, IMAGE_TYPE),
    ):
        with pytest.raises(MessageError, match=f"{kind}: its definition differs from that of ROS"):
            module(SimpleNamespace(__msgtype__=kind))


def test_a_row_that_claims_gigabytes_takes_no_memory():
    image = make_small_image(CONTAINER_START_NS)
    image.height, image.step = 1, 2**31
    with limit_time(2):
        assert read_bgr(image).shape == (1, 4, 3)
