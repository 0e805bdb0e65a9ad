"""What decode takes in: every container, every type of motion capture, and their faults."""

import numpy as np
import pytest

from calib.geometry.se3 import pose_from_xyz_quat
from calib.io.logs.open_log import open_log
from calib.sensors.camera.camera_info_reader import CAMERA_INFO_TYPE
from calib.sensors.camera.camera_info_writer import make_camera_info_message
from calib.sensors.camera.camera_model import CameraModel
from helpers import log_containers
from helpers.log_containers import (
    BOARD_BODY,
    CONTAINER_START_NS,
    LOG_CONTAINERS,
    MOCAP_TYPES,
    NS_PER_MS,
    ROBOT_BODY,
    container_decode_options,
    make_body_tracks,
    make_container_rows,
    write_in_container,
)

SHIPPED = [k for k in MOCAP_TYPES if k not in ("RigidBodies", "NamedPoseArray", "Position")]
PLACE = ("sensor", "stamp_ns", "log_time_ns", "index_at_log_time")
# SQLite files of Humble and older tell nothing of types that ROS does not ship.
MATRIX = [
    (c, k) for c in LOG_CONTAINERS for k in MOCAP_TYPES if k in SHIPPED or "no definitions" not in c
]


@pytest.mark.parametrize("container, kind", MATRIX)
def test_every_container_and_type_of_motion_capture_gives_the_same_tables(
    tmp_path, container, kind
):
    rows = make_container_rows(kind)
    options = container_decode_options(kind)
    poses, frames, audit = log_containers.decode_tables(
        write_in_container(container, tmp_path, rows), options
    )
    t, true = make_body_tracks()
    arrived = [r[0] for r in rows if r[1] not in ("/image", "/points")]
    names = dict(zip((ROBOT_BODY, BOARD_BODY), MOCAP_TYPES[kind][2], strict=True))
    assert set(poses["body"].tolist()) == set(names.values())
    coarse = kind == "Position"  # 32-bit floats, no stamp
    for body, name in names.items():
        rows_of = poses["body"] == name
        T = pose_from_xyz_quat(poses["xyz"][rows_of], poses["quat"][rows_of])
        assert np.abs(T - true[body]).max() < (1e-6 if coarse else 1e-15)
        assert (poses["fault"][rows_of] == "").all()
        log_t = poses["log_time_ns"][rows_of]
        assert set(log_t.tolist()) <= set(arrived) and len(log_t) == len(t)
        assert (poses["stamp_ns"][rows_of] == (log_t if coarse else t)).all()
        assert audit["bodies"][name]["status"]["ok"]
    assert frames["sensor"].tolist() == ["camera"] * 7 + ["lidar"] * 7
    assert frames["stamp_ns"].tolist() == 2 * t[::3].tolist()
    assert (
        frames["log_time_ns"] - frames["stamp_ns"] == [5 * NS_PER_MS] * 7 + [6 * NS_PER_MS] * 7
    ).all()
    assert audit["sensors"]["camera"]["frame"] == "camera" and audit["faults"] == []


@pytest.mark.parametrize("container", LOG_CONTAINERS)
def test_a_message_is_found_again_in_every_container(tmp_path, container):
    log = open_log(write_in_container(container, tmp_path, make_container_rows("TFMessage")))
    found = list(log.iter_messages(["/tf", "/image", "/points"]))
    assert len(found) == 34 and [m.log_time_ns for m in found] == sorted(
        m.log_time_ns for m in found
    )
    for m in found[::5]:
        again = log.read_message_content(m.topic, m.file_index, m.log_time_ns, m.index_at_log_time)
        stamped = again.transforms[0] if m.topic == "/tf" else again
        assert stamped.header.stamp == getattr(m.content, "transforms", [m.content])[0].header.stamp


def camera_info_rows(*infos):
    """Rows of a recording with a CameraInfo of a focal length, px, at each of the times, s."""
    rows = make_container_rows("TFMessage")
    for at_s, focal_px in infos:
        lens = CameraModel("radtan", (focal_px, focal_px, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0), (4, 2))
        stamp_ns = CONTAINER_START_NS + round(at_s * 1e9)
        info = make_camera_info_message(stamp_ns, "camera", lens)
        rows.append((stamp_ns, "/camera_info", CAMERA_INFO_TYPE, info))
    return sorted(rows, key=lambda row: row[0])


@pytest.mark.parametrize(
    "infos, focal_px",
    [
        ([(0.0, 300.0)], 300),
        ([(0.0, 300.0), (0.04, 310.0)], 310),  # the last before from_s
        ([(0.04, 300.0), (0.12, 320.0)], 320),  # one after from_s counts alone
    ],
)
@pytest.mark.parametrize("container", ["mcap, zstd", "split", "rosbag2, sqlite3"])
def test_a_camera_info_sent_once_before_from_s_gives_the_lens(tmp_path, container, infos, focal_px):
    log = write_in_container(container, tmp_path, camera_info_rows(*infos))
    options = container_decode_options("TFMessage") | {"from_s": 0.1}
    options["sensors"]["camera"]["camera_info"] = "/camera_info"
    _, frames, audit = log_containers.decode_tables(log, options)
    camera = audit["sensors"]["camera"]
    assert camera["status"]["ok"] and camera["camera"]["params"][0] == focal_px
    assert frames["log_time_ns"].min() - CONTAINER_START_NS >= 100 * NS_PER_MS


def test_a_camera_info_after_to_s_gives_no_lens(tmp_path):
    log = write_in_container("mcap, zstd", tmp_path, camera_info_rows((0.15, 300.0)))
    options = container_decode_options("TFMessage") | {"from_s": 0.05, "to_s": 0.1}
    options["sensors"]["camera"]["camera_info"] = "/camera_info"
    _, _, audit = log_containers.decode_tables(log, options)
    assert audit["sensors"]["camera"]["status"]["reason"] == "no CameraInfo on /camera_info"
