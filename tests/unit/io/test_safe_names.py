"""Names of every kind of mischief pass one gate: what is written holds letters that ROS allows."""

import logging

import pytest
import yaml

from calib.io.config import load_config, validate_and_complete
from calib.io.safe_names import (
    MAX_SHOWN_NAMES,
    SAFE_NAME_PATTERN,
    NameGate,
    plain_text,
    safe_name,
)
from calib.io.stage_cli import EscapingFormatter
from calib.io.status import InputError
from calib.io.urdf.urdf_file import read_urdf_joints
from helpers import log_containers
from helpers.log_containers import (
    BOARD_BODY,
    ROBOT_BODY,
    container_decode_options,
    make_container_rows,
    write_in_container,
)
from helpers.mischief import MISCHIEF

COMMAND = 'lidar$(command "touch /tmp/x")'


@pytest.mark.parametrize("name", MISCHIEF)
def test_a_name_with_other_letters_gets_a_safe_one(name):
    safe = safe_name(name)
    assert SAFE_NAME_PATTERN.fullmatch(safe) and len(safe) <= 100
    assert safe_name(name) == safe and safe_name(safe) == safe
    assert plain_text(name).isprintable() and not set(plain_text(name)) & set("<>&$`|")


@pytest.mark.parametrize("name", ["", "velodyne", "/vicon/robot/robot", "cam-0.left", "_a", "0"])
def test_a_name_that_ros_allows_stays(name):
    assert safe_name(name) == name


def test_two_names_get_two_safe_names():
    names = ["a b", "a  b", "a_b", "a\tb", "a\nb", "a$b", "ä b", " ", "\n"]
    assert len({safe_name(n) for n in names}) == len(names)


def test_the_gate_tells_of_names_escaped_and_not_of_too_many():
    gate = NameGate()
    for name in (COMMAND, COMMAND, "velodyne", "a\nhusky: STOPPED"):
        gate.admit(name)
    lines = gate.describe_replaced()
    assert len(lines) == 2 and all(line.isprintable() for line in lines)
    assert any(f"is written as {safe_name(COMMAND)}" in line for line in lines)
    for n in range(100):
        gate.admit(f"name {n}")
    lines = gate.describe_replaced()
    assert len(lines) == MAX_SHOWN_NAMES + 1
    assert lines[-1] == "82 more names of this kind are not listed"


def decode_mischief(tmp_path, container, name):
    """Tables of a log in which every frame, topic and body has a name of mischief."""
    rows = []
    for at_ns, topic, kind, message in make_container_rows("TFMessage"):
        if topic in ("/image", "/points"):
            message.header.frame_id, topic = name, f"{topic}{name}"
        else:
            for item in message.transforms:
                item.header.frame_id, item.child_frame_id = (
                    "world" + name,
                    item.child_frame_id + name,
                )
        rows.append((at_ns, topic, kind, message))
    options = container_decode_options("TFMessage")
    options["bodies"] = [safe_name(body + name) for body in options["bodies"]]
    options["mocap"]["map"] = safe_name("world" + name)
    for sensor in options["sensors"].values():
        sensor["topic"] = safe_name(sensor["topic"] + name)
    return options, log_containers.decode_tables(
        write_in_container(container, tmp_path, rows), options
    )


@pytest.mark.parametrize("name", MISCHIEF)
@pytest.mark.parametrize("container", ["mcap, zstd", "rosbag2, sqlite3"])
def test_a_log_of_mischief_is_decoded_under_safe_names(tmp_path, container, name):
    options, (poses, frames, audit) = decode_mischief(tmp_path, container, name)
    assert set(poses["body"].tolist()) == set(options["bodies"]) and len(frames["sensor"]) == 14
    assert all(audit["bodies"][body]["status"]["ok"] for body in options["bodies"])
    assert all(audit["sensors"][s]["frame"] == safe_name(name) for s in options["sensors"])
    names = [*audit["topics"], *(t["type"] for t in audit["topics"].values())]
    assert all(SAFE_NAME_PATTERN.fullmatch(n) for n in names)
    brought = ["/image" + name, "/points" + name, name, "world" + name]
    brought += [body + name for body in (ROBOT_BODY, BOARD_BODY)]
    assert len(audit["replaced_names"]) == sum(safe_name(n) != n for n in brought) > 0
    assert all(line.isprintable() for line in audit["replaced_names"])


def test_a_config_and_a_log_agree_on_safe_names(tmp_path):
    (tmp_path / "rigs").mkdir()
    (tmp_path / "targets").mkdir()
    sensors = {"top": {"kind": "lidar", "topic": COMMAND, "point_time": {"field": COMMAND}}}
    rig = {"body": "Robot 1", "mocap": {"topics": {"/a b": "Robot 1", "/c": None}, "map": "my map"}}
    rig |= {"sensors": sensors, "export": {"parent": {"frame": COMMAND, "sensor": "top"}}}
    rig["export"]["parent"]["T_parent_sensor"] = {"xyz_m": [0, 0, 0], "rpy_deg": [0, 0, 0]}
    (tmp_path / "rigs/husky.yaml").write_text(yaml.safe_dump(rig))
    board = {"body": "Board 1", "shape": "board", "outline_m": [[0, 0], [1, 0], [0, 1]]}
    (tmp_path / "targets/board.yaml").write_text(yaml.safe_dump(board))
    config = {"sessions": {"s": {"rig": "husky", "log": "x.mcap"}}}
    _, rigs, targets = load_config(config, tmp_path)
    found, safe = rigs["husky"], safe_name(COMMAND)
    assert (found["body"], found["mocap"]["map"]) == (safe_name("Robot 1"), safe_name("my map"))
    assert found["mocap"]["topics"] == {safe_name("/a b"): safe_name("Robot 1"), "/c": None}
    assert found["sensors"]["top"]["topic"] == found["export"]["parent"]["frame"] == safe
    assert found["sensors"]["top"]["point_time"]["field"] == safe
    assert targets["board"]["body"] == safe_name("Board 1")


@pytest.mark.parametrize("where", ["rig", "log"])
def test_a_config_with_a_line_break_in_a_text_is_refused(where):
    session = {"rig": "husky", "log": "x.mcap"} | {where: "a\nhusky: STOPPED"}
    with pytest.raises(InputError) as error:
        validate_and_complete("config", {"sessions": {"s": session}}, "config.yaml")
    assert f"sessions.s.{where}" in str(error.value) and str(error.value).isprintable()


def test_links_of_a_urdf_have_safe_names():
    link = COMMAND.replace('"', "&quot;")
    text = f"""<robot name="r"><joint name="j&#10;x" type="fi&#10;xed">
        <parent link="base link"/><child link='{link}'/></joint></robot>"""
    (joint,) = read_urdf_joints(text.encode(), "robot.urdf")
    assert (joint.parent, joint.child) == (safe_name("base link"), safe_name(COMMAND))
    assert SAFE_NAME_PATTERN.fullmatch(joint.name) and joint.type.isprintable()


def test_only_the_start_of_a_message_starts_a_line_of_a_log():
    text = "topic a\nerror: it broke\nTraceback"
    line = logging.LogRecord("calib", logging.WARNING, "", 0, "%s", (text,), None)
    lines = EscapingFormatter("%(message)s").format(line).splitlines()
    assert lines == ["topic a", "  error: it broke", "  Traceback"]
