"""The last lines on the terminal, and what the workflow hands to the report."""

import copy
import json
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from calib.geometry.se3 import pose_from_rpy, se3_exp
from calib.io.pose_block import pose_json
from calib.io.stage_cli import write_json
from calib.report.page.terminal_summary import format_terminal_summary
from helpers.report_inputs import (
    BOARD_CONFIG,
    NO_VIEW,
    POSE_SIGMA,
    SENSOR_CONFIGS,
    T_ROBOT_SENSOR,
    make_calibration_json,
    remove_sensor_pose,
)
from helpers.small_run import load_common_rules


def told(result, truth=None, reasons=()):
    """The lines on the terminal."""
    judged = {"verdict": result["verdict"], "reasons": list(reasons)}
    return format_terminal_summary(result, judged, truth or {})


def test_the_terminal_shows_poses_sigmas_and_errors_in_columns():
    truth = {n: {"matrix": (T @ se3_exp(POSE_SIGMA)).tolist()} for n, T in T_ROBOT_SENSOR.items()}
    head, left, top = told(make_calibration_json(), truth)
    assert head == "robo: PASS"
    assert re.fullmatch(
        r"left  100  20 300 mm ± 3, −90.000 0.000 −90.000 ° ± 0.017 error 3.7 mm 0.021° \(1 σ\)",
        left,
    )
    assert left.index("mm ±") == top.index("mm ±") and left.index("error") == top.index("error")


def test_the_terminal_says_why_a_sensor_has_no_pose():
    result = remove_sensor_pose(make_calibration_json(), "left", NO_VIEW)
    assert told(result)[1] == "left  no pose: left has no view of a target"


def test_the_terminal_takes_ten_lines_of_110_at_most_for_four_sensors():
    result = make_calibration_json()
    for name in ("front_camera", "rear_camera"):
        result["sensors"][name] = copy.deepcopy(result["sensors"]["left"])
        matrix = np.array(T_ROBOT_SENSOR["left"]) @ pose_from_rpy([-12.3, -4.5, 6.7], [1, 0.5, 2])
        result["sensors"][name]["T_robot_sensor"] = pose_json(matrix)
    truth = {n: {"matrix": np.eye(4).tolist()} for n in result["sensors"]}
    for lines in (told(result, truth), told(result, {}, [f"reason {i}" for i in range(12)])):
        assert len(lines) <= 9
        assert max(map(len, lines)) <= 110
    assert "and 9 more reasons, see the report" in lines


@pytest.fixture
def common(tmp_path, monkeypatch):
    """Function of what a rig says beyond its sensors: the names of common.smk for that rig."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    for folder in ("config/rigs", "config/targets", "logs"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "logs/s1.mcap").write_bytes(b"log")
    (tmp_path / "config/targets/board.yaml").write_text(yaml.safe_dump(BOARD_CONFIG))

    def load(**truth):
        mocap = {"topics": ["/tf"], "map": "mcs/world"}
        content = {"body": "mcs/robot", "mocap": mocap, "sensors": SENSOR_CONFIGS} | truth
        (tmp_path / "config/rigs/robo.yaml").write_text(yaml.safe_dump(content))
        return load_common_rules({"sessions": {"s1": {"rig": "robo", "log": "logs/s1.mcap"}}})

    return load


def slices(names):
    """{stage: the options that its jobs are given, as text}."""
    w = SimpleNamespace(rig="robo", session="s1", sensor="left")
    found = {k: f(w) for k, f in names.items() if k.endswith("_options") and k != "sensor_options"}
    return {k.removesuffix("_options"): v for k, v in found.items()}


def test_the_truth_changes_what_the_report_is_given_and_nothing_else(common):
    truth = {"left": {"xyz_m": [0.1, 0.02, 0.3], "rpy_deg": [-90, 0, -90]}}
    without, given = slices(common()), slices(common(truth=truth))
    assert {stage for stage in given if given[stage] != without[stage]} == {"report"}
    assert {stage for stage, text in given.items() if "truth" in text} == {"report"}
    assert json.loads(given["report"])["truth"] == truth
    assert len(given) >= 9


def test_a_wrong_truth_is_refused(common):
    with pytest.raises(Exception, match="truth.left"):
        common(truth={"left": {"xyz_m": [0.1, 0.02, 0.3]}})


def test_the_last_words_are_verdict_poses_and_where_the_report_is(
    common, tmp_path, capsys, monkeypatch
):
    """The path is one to open from where the command was given."""
    monkeypatch.setenv("PWD", str(tmp_path.parent))
    names = common(truth={"left": {"matrix": T_ROBOT_SENSOR["left"].tolist()}})
    (tmp_path / "results/robo").mkdir(parents=True)
    write_json("results/robo/calibration.json", make_calibration_json())
    judged = {"verdict": "warn", "reasons": ["top: why"], "findings": []}
    judged |= {"sensors": {"left": "pass", "top": "warn"}}
    write_json("results/robo/verdict.json", judged)
    names["print_summary"]()
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["robo: WARN", "  top: why"]
    assert lines[2].startswith("  left  100") and "error 0 mm 0°" in lines[2]
    assert lines[-1] == f"  report: {tmp_path.name}/results/robo/report.html"
    assert "top: why" in (tmp_path / "results/index.html").read_text()
