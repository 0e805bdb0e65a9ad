"""What decode takes in: every container, every type of motion capture, and their faults."""

import numpy as np
import pytest

import containers
import decode
from calib.decoding import body_tracks, decoded_log
from calib.geometry import se3
from calib.io.logs import open_log
from containers import BOARD, CONTAINERS, MS, ROBOT, TYPES

SHIPPED = [k for k in TYPES if k not in ("RigidBodies", "NamedPoseArray", "Position")]
PLACE = ("sensor", "t", "log_t", "ordinal")


def taken(log, options):
    """(columns of mocap.parquet, of frames.parquet, log.json) of a log."""
    log = open_log.open_log(log)
    recording = decoded_log.read(log, options)
    clocks = decoded_log.clocks(recording)
    poses, words = body_tracks.columns(recording, clocks, options["mocap"])
    frames = decoded_log.frame_columns(recording.frames, clocks)
    audit = decode.audit(options, log, recording, clocks, (poses, frames, words))
    return poses, frames, audit


# SQLite files of Humble and older tell nothing of types that ROS does not ship.
MATRIX = [(c, k) for c in CONTAINERS for k in TYPES if k in SHIPPED or "no definitions" not in c]


@pytest.mark.parametrize("container, kind", MATRIX)
def test_every_container_and_type_of_motion_capture_gives_the_same_tables(
    tmp_path, container, kind
):
    rows = containers.recording(kind)
    options = containers.options(kind)
    poses, frames, audit = taken(containers.write(container, tmp_path, rows), options)
    t, true = containers.track()
    arrived = [r[0] for r in rows if r[1] not in ("/image", "/points")]
    names = dict(zip((ROBOT, BOARD), TYPES[kind][2], strict=True))
    assert set(poses["body"].tolist()) == set(names.values())
    coarse = kind == "Position"  # 32-bit floats, no stamp
    for body, name in names.items():
        rows_of = poses["body"] == name
        T = se3.from_xyz_quat(poses["xyz"][rows_of], poses["quat"][rows_of])
        assert np.abs(T - true[body]).max() < (1e-6 if coarse else 1e-15)
        assert (poses["fault"][rows_of] == "").all()
        log_t = poses["log_t"][rows_of]
        assert set(log_t.tolist()) <= set(arrived) and len(log_t) == len(t)
        assert (poses["t"][rows_of] == (log_t if coarse else t)).all()
        assert audit["bodies"][name]["status"]["ok"]
    assert frames["sensor"].tolist() == ["camera"] * 7 + ["lidar"] * 7
    assert frames["t"].tolist() == 2 * t[::3].tolist()
    assert (frames["log_t"] - frames["t"] == [5 * MS] * 7 + [6 * MS] * 7).all()
    assert audit["sensors"]["camera"]["frame"] == "camera" and audit["faults"] == []


@pytest.mark.parametrize("container", CONTAINERS)
def test_a_message_is_found_again_in_every_container(tmp_path, container):
    log = open_log.open_log(
        containers.write(container, tmp_path, containers.recording("TFMessage"))
    )
    found = list(log.messages(["/tf", "/image", "/points"]))
    assert len(found) == 34 and [m.log_t for m in found] == sorted(m.log_t for m in found)
    for m in found[::5]:
        again = log.message(m.topic, m.file, m.log_t, m.ordinal)
        stamped = again.transforms[0] if m.topic == "/tf" else again
        assert stamped.header.stamp == getattr(m.content, "transforms", [m.content])[0].header.stamp
