"""Accepted calibrations: each once, in order, whole or not at all; and the page of all rigs."""

import copy
import json
import re

import numpy as np
import pytest

import export
import index
from calib.export.accepted_calibrations import (
    accept_calibration,
    read_accepted_calibrations,
    read_earlier_calibrations,
)
from calib.geometry.se3 import se3_exp
from calib.io.pose_block import pose_json
from calib.io.stage_cli import write_json
from calib.io.status import InputError
from helpers.report_inputs import (
    REPORT_TEMPLATES,
    SENSOR_CONFIGS,
    T_ROBOT_SENSOR,
    extract_page_text,
    make_calibration_json,
    make_log_audit,
    remove_plotly,
)

A, B, C = ({"rig": "robo", "sensors": {n: {}}} for n in "abc")
OLD_NAMES = "0123456789abcdef", "fedcba9876543210"


def write_entry(folder, name, previous, calibration):
    (folder / f"{name}.json").write_text(
        json.dumps({"previous": previous, "calibration": calibration})
    )


def test_what_is_accepted_again_adds_nothing(tmp_path):
    first = accept_calibration(tmp_path, A)
    before = (tmp_path / f"{first}.json").read_bytes()
    assert accept_calibration(tmp_path, copy.deepcopy(A)) == first == "0001"
    assert [p.name for p in tmp_path.iterdir()] == ["0001.json"]
    assert (tmp_path / "0001.json").read_bytes() == before


def test_the_order_is_that_in_which_they_were_accepted_also_of_one_that_comes_back(tmp_path):
    names = [accept_calibration(tmp_path, c) for c in (A, B, C, A)]
    found = read_accepted_calibrations(tmp_path)
    assert names == ["0001", "0002", "0003", "0004"]
    assert [n for n, _ in found] == names and [c for _, c in found] == [A, B, C, A]


def test_every_entry_names_its_predecessor(tmp_path):
    for calibration in (A, B, C):
        accept_calibration(tmp_path, calibration)
    entries = [json.loads(p.read_text()) for p in sorted(tmp_path.iterdir())]
    assert [e["previous"] for e in entries] == [None, "0001", "0002"]


def test_the_same_calibrations_give_the_same_bytes(tmp_path):
    one, other = tmp_path / "one", tmp_path / "other"
    for folder in (one, other):
        for calibration in (A, B):
            accept_calibration(folder, calibration)
    assert [p.read_bytes() for p in sorted(one.iterdir())] == [
        p.read_bytes() for p in sorted(other.iterdir())
    ]


def test_before_is_the_same_whether_or_not_the_calibration_was_accepted_by_then(tmp_path):
    accept_calibration(tmp_path, A)
    early = read_earlier_calibrations(tmp_path, B)
    accept_calibration(tmp_path, B)
    assert (
        read_earlier_calibrations(tmp_path, B) == early == read_accepted_calibrations(tmp_path)[:1]
    )


def test_a_folder_without_history_has_none(tmp_path):
    assert (
        read_accepted_calibrations(tmp_path / "no")
        == read_earlier_calibrations(tmp_path / "no", A)
        == []
    )


def test_files_named_after_their_content_by_earlier_versions_come_first(tmp_path):
    newest, oldest = OLD_NAMES
    write_entry(tmp_path, oldest, None, A)
    write_entry(tmp_path, newest, oldest, B)
    assert accept_calibration(tmp_path, B) == newest
    assert accept_calibration(tmp_path, C) == "0001"
    assert [n for n, _ in read_accepted_calibrations(tmp_path)] == [oldest, newest, "0001"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{}", "0001.json is no accepted calibration: expected {previous, calibration}"),
        ("{", "0001.json cannot be read"),
        ("\udcff", "0001.json cannot be read"),
        ('{"previous": null, "calibration": {}}', "0001.json holds no calibration with sensors"),
        ('{"previous": [], "calibration": {}}', "0001.json follows []"),
    ],
)
def test_a_damaged_entry_is_refused(tmp_path, content, message):
    accept_calibration(tmp_path, A)
    (tmp_path / "0001.json").write_bytes(content.encode(errors="surrogateescape"))
    with pytest.raises(InputError, match=re.escape(message)):
        read_accepted_calibrations(tmp_path)


def test_an_entry_whose_forerunner_is_gone_is_refused(tmp_path):
    for calibration in (A, B):
        accept_calibration(tmp_path, calibration)
    (tmp_path / "0001.json").unlink()
    with pytest.raises(InputError, match="0002.json follows 0001.json, which is missing") as error:
        accept_calibration(tmp_path, C)
    assert "Put the right file back, or move this folder away" in str(error.value)
    assert [p.name for p in tmp_path.iterdir()] == ["0002.json"]


def test_foreign_files_are_all_named_in_one_message(tmp_path):
    accept_calibration(tmp_path, A)
    for name in ("0001 (copy).json", "notes.json"):
        (tmp_path / name).write_text("{}")
    with pytest.raises(InputError) as error:
        accept_calibration(tmp_path, B)
    assert "0001 (copy).json does not belong here" in str(error.value)
    assert "notes.json does not belong here: expected names such as 0001.json" in str(error.value)


def test_two_files_that_follow_one_are_refused(tmp_path):
    for calibration in (A, B):
        accept_calibration(tmp_path, calibration)
    write_entry(tmp_path, "0003", "0001", C)
    with pytest.raises(InputError, match="0002.json and 0003.json both follow 0001"):
        read_accepted_calibrations(tmp_path)


def test_files_that_follow_each_other_are_refused(tmp_path):
    write_entry(tmp_path, "0001", "0002", A)
    write_entry(tmp_path, "0002", "0001", B)
    with pytest.raises(InputError, match="0001.json, 0002.json follow each other"):
        read_accepted_calibrations(tmp_path)


def test_what_was_begun_and_never_ended_is_no_entry(tmp_path):
    accept_calibration(tmp_path, A)
    (tmp_path / ".0002.json.part").write_text('{"previous"')
    (tmp_path / ".0002.json").write_text('{"previous"')
    assert len(read_accepted_calibrations(tmp_path)) == 1


def results(folder, name, level="pass", moved=0.0, repeatability=()):
    """A rig's results: both sensors, the left one moved along its x axis by so many m."""
    calibration = make_calibration_json() | {"rig": name, "verdict": level}
    there = T_ROBOT_SENSOR["left"] @ se3_exp(np.array([moved, 0, 0, 0, 0, 0]))
    calibration["sensors"]["left"]["T_robot_sensor"] = pose_json(there)
    calibration["repeatability"] = list(repeatability)
    reason = f"left: <{level}>"
    judged = {"verdict": level, "reasons": [] if level == "pass" else [reason], "findings": []}
    judged |= {"sensors": dict.fromkeys(SENSOR_CONFIGS, level), "limits": {}}
    home = folder / "results" / name
    (home / "s1").mkdir(parents=True, exist_ok=True)
    write_json(home / "calibration.json", calibration)
    write_json(home / "verdict.json", judged)
    write_json(home / "s1/log.json", make_log_audit())
    return home


def exported(home):
    """Run export on a rig's results."""
    options = {"export": {"parent": "", "max_views": 1, "body_frames": {}}, "body": "mcs/robot"}
    options |= {"sensors": SENSOR_CONFIGS, "targets": {}, "sessions": {}}
    files = {"calibration": "calibration.json", "verdict": "verdict.json"}
    files |= {"output": "export", "history": "history"}
    paths = [a for k, v in files.items() for a in (f"--{k}", str(home / v))]
    paths += ["--frames", "--placements", "--guesses", "--views", "--urdf"]
    export.main([*paths, "--options", json.dumps(options)])


def page(folder, **stopped):
    """results/index.html of all rigs there, and of those that stopped."""
    names = sorted({p.name for p in (folder / "results").iterdir() if p.is_dir()} | set(stopped))
    rigs = {n: {"sessions": ["s1"], "stopped": stopped.get(n, [])} for n in names}
    out = folder / "results/index.html"
    templates = [str(p) for p in REPORT_TEMPLATES if p.suffix in (".j2", ".css", ".js")]
    arguments = ["--results", str(folder / "results"), "--output", str(out), "--templates"]
    index.main([*arguments, *templates, "--options", json.dumps({"rigs": rigs})])
    return out.read_text()


def test_drift_is_told_against_the_calibration_that_was_accepted_before(tmp_path):
    """3 mm along an axis of σ 1 mm, both poses unsure: √(9 / 2 / 6) = 0.87 σ."""
    exported(results(tmp_path, "robo"))
    home = results(tmp_path, "robo", moved=0.003)
    early = page(tmp_path)
    assert "left camera PASS 3 0.017 3 0 0.87 – –" in extract_page_text(early)
    exported(home)
    assert page(tmp_path).replace('<a href="robo/export">export</a> · ', "") == early.replace(
        '<a href="robo/export">export</a> · ', ""
    )


def test_a_failed_calibration_is_compared_with_the_last_accepted_and_not_kept(tmp_path):
    exported(results(tmp_path, "robo"))
    home = results(tmp_path, "robo", level="fail", moved=0.05)
    with pytest.raises(InputError):
        exported(home)
    assert len(list((home / "history").iterdir())) == 1
    text = page(tmp_path)
    assert "left camera FAIL 3 0.017 50 0 14" in extract_page_text(text)
    assert "left: &lt;fail&gt;" in text


def test_without_an_accepted_calibration_there_is_no_drift(tmp_path):
    results(tmp_path, "robo")
    said = extract_page_text(page(tmp_path))
    assert "No calibration was accepted before this one" in said
    assert "left camera PASS 3 0.017 – – – – –" in said


def test_repeatability_is_the_scatter_of_sessions_by_themselves(tmp_path):
    row = {
        "session": "s1",
        "sensor": "left",
        "n_other_sessions": 1,
        "p_value": 0.5,
        "sigma": [1e-3] * 6,
    }
    rows = [row | {"shift": [0.003, 0.004, 0, 0, 0, s * 1e-3]} for s in (1, -1)]
    results(tmp_path, "robo", repeatability=rows)
    assert "left camera PASS 3 0.017 – – – 5 0.057" in extract_page_text(page(tmp_path))


def test_a_rig_that_stopped_is_there_with_what_stopped_it_beside_the_healthy(tmp_path):
    results(tmp_path, "robo")
    said = extract_page_text(page(tmp_path, husky=["results/husky/s/decode.log: no such <log>"]))
    assert "husky FAIL results/husky/s/decode.log: no such &lt;log&gt;" in said
    assert "robo PASS All sensors are within all limits. 2 1 0" in said


def test_a_damaged_history_is_named_on_the_page(tmp_path):
    home = results(tmp_path, "robo")
    exported(home)
    (entry,) = (home / "history").iterdir()
    entry.write_text("{}")
    assert "0001.json is no accepted calibration" in extract_page_text(page(tmp_path))


def test_links_lead_to_what_is_there(tmp_path):
    home = results(tmp_path, "robo")
    (home / "report.html").write_text("")
    text = remove_plotly(page(tmp_path))
    assert '<a href="robo/report.html">report</a>' in text
    assert "report.pdf" not in text
    assert "http" not in text


SENSOR = {"T_robot_sensor": pose_json(np.eye(4)), "covariance": (1e-6 * np.eye(6)).tolist()}
WRONG_SHAPES = {
    "sensor": "text",
    "no pose": {"covariance": None},
    "pose": SENSOR | {"T_robot_sensor": [1, 2, 3]},
    "matrix": SENSOR | {"T_robot_sensor": SENSOR["T_robot_sensor"] | {"matrix": [[1, 2], [3]]}},
    "numbers": SENSOR | {"T_robot_sensor": SENSOR["T_robot_sensor"] | {"xyz_m": ["x", 1, {}]}},
    "infinite": SENSOR | {"T_robot_sensor": SENSOR["T_robot_sensor"] | {"xyz_m": [1e300, 1, 2]}},
    "covariance": SENSOR | {"covariance": None},
    "singular": SENSOR | {"covariance": np.zeros((6, 6)).tolist()},
}


@pytest.mark.parametrize("name", WRONG_SHAPES)
def test_a_file_of_wrong_shapes_is_named_before_the_page_compares_poses_with_it(tmp_path, name):
    good = {"rig": "robo", "sensors": {"left": SENSOR, "right": {**SENSOR, "T_robot_sensor": None}}}
    write_entry(tmp_path, "0001", None, good)
    assert len(read_accepted_calibrations(tmp_path)) == 1
    write_entry(tmp_path, "0002", "0001", {"rig": "robo", "sensors": {"left": WRONG_SHAPES[name]}})
    with pytest.raises(InputError, match=r"0002\.json holds .* of left"):
        read_accepted_calibrations(tmp_path)


def test_a_history_file_nested_without_end_is_named(tmp_path):
    (tmp_path / "0001.json").write_text("[" * 100_000)
    with pytest.raises(InputError, match=r"0001\.json cannot be read"):
        read_accepted_calibrations(tmp_path)
