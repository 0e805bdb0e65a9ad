"""What decode takes in: every container, every type of motion capture, and their faults."""

import numpy as np
import pytest

from calib.geometry.se3 import pose_from_xyz_quat
from calib.io.logs.open_log import open_log
from helpers import log_containers
from helpers.log_containers import (
    BOARD_BODY,
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
