"""What users write: completed where they are silent, refused in words where they are wrong."""

import copy
import datetime

import numpy as np
import pytest
import yaml

from benchmarking.fuzzing.random_configs import VALID_FILES
from calib.geometry.se3 import invert_pose, pose_from_rpy, pose_to_quat, rotation_angle
from calib.io.config import (
    RENAMED_KEYS,
    default_config_blocks,
    load_config,
    validate_and_complete,
)
from calib.io.pose_block import pose_from_config, pose_json, pose_sigma_from_config
from calib.io.session_parts import cut_sessions
from calib.io.status import InputError
from calib.sensors.lidar.lidar_model import LidarModel
from calib.sensors.sensor_models import camera_from_config
from calib.targets.target_shapes import target_from_config

CONFIG = yaml.safe_load("""
sessions:
  morning: {rig: husky, log: logs/morning}
  evening: {rig: husky, log: [logs/e_0.mcap, logs/e_1.mcap], targets: [diamond],
            sensors: [velodyne], from_s: 10, to_s: 200}
solve: {estimate: {time_offset: auto, target_alignment: auto, intrinsics: false}}
""")
RIG = yaml.safe_load("""
body: vicon/robot/robot
mocap: {topics: [/tf], map: vicon/world, max_gap_s: 0.05,
        pose_sigma: {xyz_m: 0.0002, rpy_deg: 0.02}}
sensors:
  velodyne:
    kind: lidar
    topic: /velodyne_points
    T_robot_sensor: {xyz_m: [0.21, 0, 0.62], rpy_deg: [0, 0, 2]}
    guess_sigma: {xyz_m: 0.05, rpy_deg: 5}
    azimuth_step_deg: 0.2
    range_sigma_m: 0.01
  left:
    kind: camera
    topic: /left/image_raw
    model: radtan
    size_px: [1280, 960]
    params: [812, 810, 651, 472, -0.28, 0.09, 0.0006, -0.0004]
""")
DIAMOND = yaml.safe_load("""
body: vicon/diamond/diamond
shape: board
outline_m: [[0.7071, 0], [0, 0.7071], [-0.7071, 0], [0, -0.7071]]
thickness_m: 0.005
pattern: {kind: checkerboard, inner_corners: [6, 5], square_m: 0.08,
          first_corner_m: [-0.20, -0.16], first_square: black}
T_body_target: {xyz_m: [0, 0, 0], rpy_deg: [0, 0, 0]}
alignment_sigma: {xyz_m: 0.002, rpy_deg: 0.3}
""")
CYLINDER = yaml.safe_load("""
body: vicon/cylinder/cylinder
shape: cylinder
length_m: 0.8
radius_m: 0.1
color: {hue_deg: [90, 150], saturation: [0.3, 1], value: [0.15, 1]}
""")
GOOD = {"config": CONFIG, "rig": RIG, "diamond": DIAMOND, "cylinder": CYLINDER}


@pytest.fixture
def folder(tmp_path):
    """A config folder with the examples of the documentation."""
    for name in ("rigs", "targets"):
        (tmp_path / "config" / name).mkdir(parents=True)
    write(tmp_path / "config/rigs/husky.yaml", RIG)
    write(tmp_path / "config/targets/diamond.yaml", DIAMOND)
    write(tmp_path / "config/targets/cylinder.yaml", CYLINDER)
    return tmp_path / "config"


def write(path, content):
    path.write_text(yaml.safe_dump(content))


def edited(what, path, value):
    """A good example with one key changed, at a path like a.b.c; None removes it."""
    out = copy.deepcopy(GOOD[what])
    *parents, last = path.split(".")
    block = out
    for key in parents:
        block = block.setdefault(key, {})
    if value is None:
        del block[last]
    else:
        block[last] = value
    return out


def complete(what, content):
    kind = what if what in ("config", "rig") else "target"
    return validate_and_complete(kind, copy.deepcopy(content), f"{what}.yaml")


def refusal(what, content):
    with pytest.raises(InputError) as caught:
        complete(what, content)
    return str(caught.value)


# --- what is right


@pytest.mark.parametrize(
    ("text", "number"),
    [("1e-3", 0.001), ("15e-5", 0.00015), ("2.5E3", 2500.0), ("-5e-2", -0.05), ("+3e0", 3.0)],
)
def test_a_number_that_yaml_reads_as_text_is_the_number_that_it_is(text, number):
    assert yaml.safe_load(text) == text  # so YAML 1.1 has it
    pose = {"xyz_m": [text, 0, 0], "rpy_deg": [0, 0, 0]}
    found = complete("rig", edited("rig", "sensors.left.T_robot_sensor", pose))
    assert found["sensors"]["left"]["T_robot_sensor"]["xyz_m"] == [pytest.approx(number), 0, 0]


def test_a_text_that_looks_like_a_number_stays_text_where_text_is_expected():
    assert complete("rig", edited("rig", "body", "1e-3"))["body"] == "1e-3"


def test_a_whole_number_as_text_is_one_where_one_is_expected():
    found = complete("rig", edited("rig", "sensors.left.size_px", ["128e1", 960]))
    assert found["sensors"]["left"]["size_px"] == [1280, 960]


@pytest.mark.parametrize("what", GOOD)
def test_the_examples_of_the_documentation_are_valid_and_keep_what_they_say(what):
    found = complete(what, GOOD[what])

    def kept(before, after):
        if isinstance(before, dict):
            return all(kept(v, after[k]) for k, v in before.items())
        return before == after

    assert kept(GOOD[what], found)


def test_defaults_are_completed_in_blocks_that_are_there_and_in_blocks_that_are_not():
    found = complete("config", {"sessions": CONFIG["sessions"], "gate": {"trim_s": 0.2}})
    assert found["gate"]["trim_s"] == 0.2
    assert found["gate"]["window_s"] == 0.3
    assert found["solve"]["estimate"]["time_offset"] == "auto"
    assert found["guess"]["sigma"] == {"xyz_m": 0.05, "rpy_deg": 5}
    stages = {"gate", "guess", "crop", "extract", "associate", "solve", "judge", "report", "export"}
    assert stages <= set(found)


def test_defaults_are_completed_in_every_sensor_and_target():
    found = complete("rig", edited("rig", "sensors.velodyne.azimuth_step_deg", None))
    assert found["sensors"]["velodyne"]["azimuth_step_deg"] == 0.2
    assert found["sensors"]["velodyne"]["range_m"] == [0.3, 100]
    assert "azimuth_step_deg" not in found["sensors"]["left"]
    assert found["mocap"]["pose_bias_sigma"] == {"xyz_m": 0.0001, "rpy_deg": 0.01}
    board = complete("diamond", edited("diamond", "T_body_target", None))
    assert board["T_body_target"] == {"xyz_m": [0, 0, 0], "rpy_deg": [0, 0, 0]}
    assert complete("diamond", edited("diamond", "thickness_m", None))["thickness_m"] == 0


def test_a_default_belongs_to_one_config_alone():
    first = complete("cylinder", CYLINDER)
    first["T_body_target"]["xyz_m"][0] = 99
    assert complete("cylinder", CYLINDER)["T_body_target"]["xyz_m"] == [0, 0, 0]


def test_every_default_of_every_schema_is_itself_valid():
    assert complete("config", complete("config", CONFIG))
    assert complete("rig", complete("rig", RIG))


# --- unknown keys


@pytest.mark.parametrize(
    "what, path, words",
    [
        (
            "config",
            "sesions",
            "config.yaml: top level: unknown key sesions. Did you mean sessions?",
        ),
        ("config", "gate.windows_s", "gate: unknown key windows_s. Did you mean window_s?"),
        (
            "config",
            "sessions.morning.sensor",
            "sessions.morning: unknown key sensor. Did you mean sensors?",
        ),
        (
            "config",
            "solve.estimate.time_ofset",
            "solve.estimate: unknown key time_ofset. Did you mean time_",
        ),
        ("config", "zzz", "unknown key zzz. Known: associate, crop, "),
        ("rig", "mocapp", "rig.yaml: top level: unknown key mocapp. Did you mean mocap?"),
        ("rig", "mocap.maxgap_s", "mocap: unknown key maxgap_s. Did you mean max_gap_s?"),
        (
            "rig",
            "sensors.velodyne.azimut_step_deg",
            "sensors.velodyne: unknown key azimut_step_deg. Did",
        ),
        ("rig", "sensors.left.parms", "sensors.left: unknown key parms. Did you mean params?"),
        (
            "rig",
            "sensors.velodyne.T_robot_sensor.rpy",
            "sensors.velodyne.T_robot_sensor: unknown key rpy",
        ),
        ("diamond", "tickness_m", "top level: unknown key tickness_m. Did you mean thickness_m?"),
        ("diamond", "pattern.square", "pattern: unknown key square. Did you mean square_m?"),
        ("cylinder", "radius", "top level: unknown key radius. Did you mean radius_m?"),
        ("cylinder", "color.hue", "color: unknown key hue. Did you mean hue_deg?"),
    ],
)
def test_an_unknown_key_is_refused_with_its_path_and_the_nearest_name(what, path, words):
    assert words in refusal(what, edited(what, path, 1))


def config_value(blocks, path):
    for key in path.split("."):
        blocks = blocks.get(key, {})
    return blocks


@pytest.mark.parametrize("old", RENAMED_KEYS)
def test_a_former_key_is_refused_with_its_name_today(old):
    new, blocks = RENAMED_KEYS[old], default_config_blocks()
    assert config_value(blocks, new) != {} and config_value(blocks, old) == {}
    config = CONFIG | {"solve": {"estimate": {}}, "judge": {}, "crop": {}, "guess": {}}
    assert f"config.yaml: renamed keys: {old} is now {new}. Use" in refusal(
        "config", edited_block(config, old)
    )


def edited_block(config, path):
    """A copy of a config with a number at a path."""
    out = copy.deepcopy(config)
    block, (*parents, key) = out, path.split(".")
    for name in parents:
        block = block[name]
    block[key] = 1
    return out


def test_all_former_keys_of_a_config_are_named_at_once():
    config = CONFIG | {"judge": {"warn_heldout": 2, "warn_beyond": 0.1}, "gate": {"windows_s": 1}}
    words = "judge.warn_beyond is now judge.warn_tail_share; judge.warn_heldout is now"
    assert words in refusal("config", config)


@pytest.mark.parametrize("key", [7, True, 2026.5])
def test_a_key_that_yaml_does_not_read_as_text_is_refused_not_stumbled_over(key):
    assert f"unknown key {key}" in refusal("config", CONFIG | {key: 1})
    assert "unknown key" in refusal("config", CONFIG | {key: 1, "gait": 2})


def test_the_lens_comes_from_params_or_from_camera_info_never_from_both():
    both = edited("rig", "sensors.left.camera_info", "/left/camera_info")
    words = "sensors.left: params and camera_info exclude each other; keep one"
    assert words in refusal("rig", both)
    for key in ("model", "size_px", "params"):
        del both["sensors"]["left"][key]
    assert validate_and_complete("rig", both, "rig.yaml")


@pytest.mark.parametrize(
    "block, words",
    [
        ({"unit": "min"}, "point_time.unit: 'min' is not one of ['s', 'ms', 'us', 'ns']"),
        ({"origin": "end"}, "point_time.origin: 'end' is not one of ['stamp', 'clock', 'first'"),
        ({"feild": "stamp_ns"}, "point_time: unknown key feild. Did you mean field?"),
        ({}, "point_time: {} should be non-empty"),
    ],
)
def test_a_point_time_is_a_field_a_unit_and_an_origin(block, words):
    assert words in refusal("rig", edited("rig", "sensors.velodyne.point_time", block))


def test_a_key_of_one_kind_of_sensor_is_unknown_to_the_other():
    assert "sensors.left: unknown key range_m" in refusal(
        "rig", edited("rig", "sensors.left.range_m", [0, 1])
    )
    assert "sensors.velodyne: unknown key params" in refusal(
        "rig", edited("rig", "sensors.velodyne.params", [1])
    )


# --- missing keys, wrong values


@pytest.mark.parametrize(
    "what, path, words",
    [
        ("config", "sessions", "config.yaml: top level: missing key sessions"),
        ("config", "sessions.morning.log", "sessions.morning: missing key log"),
        ("config", "sessions.morning.rig", "sessions.morning: missing key rig"),
        ("rig", "body", "rig.yaml: top level: missing key body"),
        ("rig", "mocap.map", "mocap: missing key map"),
        ("rig", "sensors.left.kind", "sensors.left: missing key kind"),
        ("rig", "sensors.left.topic", "sensors.left: missing key topic"),
        ("rig", "sensors.left.model", "sensors.left: missing key model"),
        ("rig", "sensors.left.params", "sensors.left: missing key params"),
        (
            "rig",
            "sensors.velodyne.guess_sigma.xyz_m",
            "sensors.velodyne.guess_sigma: missing key xyz_m",
        ),
        ("diamond", "shape", "diamond.yaml: top level: missing key shape"),
        ("diamond", "outline_m", "top level: missing key outline_m"),
        ("diamond", "pattern.kind", "pattern: missing key kind"),
        ("cylinder", "length_m", "top level: missing key length_m"),
    ],
)
def test_a_missing_key_is_named_with_its_path(what, path, words):
    assert words in refusal(what, edited(what, path, None))


@pytest.mark.parametrize(
    "what, path, value, words",
    [
        ("config", "gate.window_s", "1e-3 s", "gate.window_s: '1e-3 s' is not of type 'number'"),
        ("config", "gate.window_s", "1e999", "gate.window_s: inf is not a finite number"),
        ("rig", "sensors.left.size_px", ["6.5e0", 480], "size_px.0: 6.5 is not of type 'integer'"),
        ("rig", "body", 1, "body: 1 is not of type 'string'. YAML reads it as a number. Write it"),
        ("rig", "mocap.map", True, "YAML reads yes, no, on and off as true and false. Write it"),
        (
            "diamond",
            "body",
            datetime.date(2026, 3, 1),
            'YAML reads it as a date. Write it in quotes: "2026-03-01".',
        ),
        ("rig", "mocap.topics", {"/tf": 3}, 'YAML reads it as a number. Write it in quotes: "3".'),
        (
            "config",
            "gate.window_s",
            -1,
            "gate.window_s: -1 is less than or equal to the minimum of 0",
        ),
        (
            "config",
            "judge.fail_rejected",
            1.5,
            "judge.fail_rejected: 1.5 is greater than the maximum",
        ),
        ("config", "gate", [1], "gate: [1] is not of type 'object'"),
        ("config", "sessions.morning.log", 7, "log: 7; expected An .mcap file, a rosbag2 folder"),
        (
            "config",
            "sessions.morning.targets",
            [],
            "sessions.morning.targets: [] should be non-empty",
        ),
        ("config", "sessions", {}, "sessions: {} should be non-empty"),
        ("rig", "sensors", {}, "sensors: {} should be non-empty"),
        ("rig", "sensors.left.kind", "radar", "sensors.left.kind: 'radar' is not one of"),
        (
            "rig",
            "sensors.left.model",
            "fisheye",
            "sensors.left.model: 'fisheye' is not one of ['radtan'",
        ),
        ("rig", "sensors.left.size_px", [640.5, 480], "size_px.0: 640.5 is not of type 'integer'"),
        ("rig", "sensors.left", "none", "sensors.left: 'none' is not of type 'object'"),
        (
            "rig",
            "mocap.topics",
            "/tf",
            "mocap.topics: /tf; expected a list of topics, or a mapping",
        ),
        ("rig", "mocap.topics", {"/tf": 3}, "mocap.topics./tf: 3 is not of type 'string', 'null'"),
        ("diamond", "shape", "ball", "shape: 'ball' is not one of ['board', 'cylinder', 'cloud']"),
        ("diamond", "outline_m", [[0, 0], [1, 0]], "outline_m: [[0, 0], [1, 0]] is too short"),
        ("diamond", "pattern.inner_corners", [6, 2], "pattern.inner_corners.1: 2 is less than the"),
        ("cylinder", "radius_m", 0, "radius_m: 0 is less than or equal to the minimum of 0"),
    ],
)
def test_a_wrong_value_is_refused_with_its_path_and_what_it_should_be(what, path, value, words):
    assert words in refusal(what, edited(what, path, value))


@pytest.mark.parametrize(
    "pose",
    [
        {"xyz_m": [0, 0, 0]},
        {"rpy_deg": [0, 0, 0]},
        {"xyz_m": [0, 0, 0], "rpy_deg": [0, 0, 0], "quat_xyzw": [0, 0, 0, 1]},
        {"matrix": np.eye(4).tolist(), "xyz_m": [0, 0, 0]},
    ],
)
def test_a_pose_is_stated_in_one_way_only(pose):
    message = refusal("rig", edited("rig", "sensors.left.T_robot_sensor", pose))
    assert "sensors.left.T_robot_sensor: " in message
    assert "expected xyz_m with rpy_deg or quat_xyzw, or a 4 x 4 matrix" in message


@pytest.mark.parametrize("content", [None, [1], "text", 3])
def test_a_file_without_keys_is_refused(content):
    with pytest.raises(InputError, match="x.yaml: holds .*, expected keys and values"):
        validate_and_complete("rig", content, "x.yaml")


# --- names


@pytest.mark.parametrize("name", ["export", "figures", "index"])
@pytest.mark.parametrize("what", ["sessions", "sensors"])
def test_a_reserved_name_is_refused(what, name):
    file = {"sessions": "config", "sensors": "rig"}[what]
    some = next(iter(GOOD[file][what].values()))
    message = refusal(file, edited(file, what, {name: some}))
    assert f"{what}: {name} is a reserved name. Choose another name." in message


@pytest.mark.parametrize(
    "name", ["Left", "left cam", "_left", "-left", "left/rear", "", "läft", "a.b"]
)
@pytest.mark.parametrize("what", ["sessions", "sensors"])
def test_a_bad_name_is_refused_with_what_a_name_is(what, name):
    file = {"sessions": "config", "sensors": "rig"}[what]
    some = next(iter(GOOD[file][what].values()))
    out = copy.deepcopy(GOOD[file])
    out[what] = {name: some}
    assert f"{what}: {name!r} is not a valid name. Use at most 64 of a-z, 0-9, _ and -" in refusal(
        file, out
    )


@pytest.mark.parametrize("name", [7, True])
def test_a_name_that_yaml_does_not_read_as_text_is_refused(name):
    out = copy.deepcopy(CONFIG)
    out["sessions"][name] = out["sessions"]["morning"]
    assert f"sessions: {name} is not of type 'string'" in refusal("config", out)


@pytest.mark.parametrize("name", ["a", "0", "left_2-rear", "2026-03-01"])
def test_a_good_name_is_taken(name):
    assert complete("config", edited("config", "sessions", {name: CONFIG["sessions"]["morning"]}))


@pytest.mark.parametrize(
    "name, words", [("index", "reserved"), ("Big Board", "is not a valid name")]
)
def test_the_file_of_a_target_needs_a_good_name(folder, name, words):
    write(folder / "targets" / f"{name}.yaml", DIAMOND)
    with pytest.raises(InputError, match=words) as caught:
        load(folder)
    assert f"targets/{name}.yaml" in str(caught.value)


# --- all files together


def load(folder, content=CONFIG):
    return load_config(copy.deepcopy(content), str(folder))


def test_a_session_gets_all_sensors_and_targets_unless_it_names_some(folder):
    found, rigs, targets = load(folder)
    assert found["sessions"]["morning"]["sensors"] == ["left", "velodyne"]
    assert found["sessions"]["morning"]["targets"] == ["cylinder", "diamond"]
    assert found["sessions"]["evening"]["sensors"] == ["velodyne"]
    assert found["sessions"]["evening"]["targets"] == ["diamond"]
    assert set(rigs) == {"husky"} and set(targets) == {"diamond", "cylinder"}
    assert rigs["husky"]["sensors"]["velodyne"]["elevation_step_deg"] == 2.0


def test_the_slices_of_a_loaded_rig_are_si_units(folder):
    _, rigs, _ = load(folder)
    lidar = LidarModel.from_config(rigs["husky"]["sensors"]["velodyne"])
    assert lidar.azimuth_step == pytest.approx(np.radians(0.2))
    assert lidar.range_sigma == 0.01 and lidar.azimuth_limits is None
    sigma = pose_sigma_from_config(rigs["husky"]["mocap"]["pose_sigma"])
    assert sigma == pytest.approx([2e-4] * 3 + [np.radians(0.02)] * 3)
    camera = camera_from_config(rigs["husky"]["sensors"]["left"])
    assert camera.size_px == (1280, 960) and camera.params[:2] == (812, 810)


@pytest.mark.parametrize(
    "key, name, words",
    [
        (
            "sensors",
            "velodine",
            "sessions.morning.sensors: velodine does not exist. Did you mean velodyne?",
        ),
        (
            "sensors",
            "radar",
            "sessions.morning.sensors: radar does not exist. Known: left, velodyne",
        ),
        (
            "targets",
            "dimond",
            "sessions.morning.targets: dimond does not exist. Did you mean diamond?",
        ),
    ],
)
def test_a_session_that_names_what_is_not_there_is_refused(folder, key, name, words):
    with pytest.raises(InputError) as caught:
        load(folder, edited("config", f"sessions.morning.{key}", [name]))
    assert words in str(caught.value) and "config.yaml" in str(caught.value)


def test_a_missing_rig_file_is_named(folder):
    with pytest.raises(InputError, match=r"rigs/spot\.yaml: no such file"):
        load(folder, edited("config", "sessions.morning.rig", "spot"))


def test_invalid_yaml_is_refused_with_file_and_line(folder):
    (folder / "rigs/husky.yaml").write_text("body: [a\nmocap: {")
    with pytest.raises(InputError, match=r"rigs/husky\.yaml: not valid YAML: (.|\n)*line 2"):
        load(folder)


def test_a_file_that_is_no_text_is_refused(folder):
    (folder / "targets/diamond.yaml").write_bytes(b"\xff\xfe\x00body")
    with pytest.raises(InputError, match=r"targets/diamond\.yaml: not valid YAML"):
        load(folder)


def test_an_empty_file_is_refused(folder):
    (folder / "targets/diamond.yaml").write_text("")
    with pytest.raises(InputError, match=r"targets/diamond\.yaml: holds NoneType, expected keys"):
        load(folder)


def test_no_target_file_is_refused(folder):
    for path in (folder / "targets").iterdir():
        path.unlink()
    with pytest.raises(InputError, match="targets: no file found; expected at least one YAML file"):
        load(folder)


def test_an_error_in_a_rig_or_target_names_its_file(folder):
    write(folder / "targets/diamond.yaml", edited("diamond", "tickness_m", 1))
    with pytest.raises(
        InputError, match=r"targets/diamond\.yaml: top level: unknown key tickness_m"
    ):
        load(folder)


# --- poses and cameras of a config


TURN = pose_from_rpy([0.21, 0, 0.62], np.radians([10, -20, 130]))


def test_the_three_ways_to_state_a_pose_say_the_same():
    rpy = pose_from_config({"xyz_m": [0.21, 0, 0.62], "rpy_deg": [10, -20, 130]})
    quat = pose_from_config({"xyz_m": [0.21, 0, 0.62], "quat_xyzw": pose_to_quat(TURN).tolist()})
    matrix = pose_from_config({"matrix": TURN.tolist()})
    for T in (rpy, quat, matrix, pose_from_config({"matrix": pose_json(TURN)["matrix"]})):
        assert pytest.approx(TURN, abs=1e-15) == T


def test_a_pose_rounded_to_two_decimals_becomes_the_nearest_rigid_motion():
    for config_ in (
        {"matrix": np.round(TURN, 2).tolist()},
        {"xyz_m": [0.21, 0, 0.62], "quat_xyzw": np.round(pose_to_quat(TURN), 2).tolist()},
    ):
        T = pose_from_config(config_)
        assert T[:3, :3].T @ T[:3, :3] == pytest.approx(np.eye(3), abs=1e-14)
        assert rotation_angle(invert_pose(TURN) @ T) < 0.02


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda T: 1.1 * T[:3, :3], "determinant 1.331, expected 1"),
        (lambda T: T[:3, :3] @ np.diag([1, 1, -1]), "determinant -1, expected 1"),
        (lambda T: 0 * T[:3, :3], "determinant 0, expected 1"),
        (
            lambda T: T[:3, :3] @ [[1, 0.3, 0], [0, 1, 0], [0, 0, 1]],
            "error of its axes 0.3, expected below 0.02",
        ),
        (lambda T: T[:3, :3] * np.nan, "determinant nan"),
    ],
)
def test_a_matrix_that_is_no_rigid_motion_is_refused_with_what_it_is_and_the_remedy(change, words):
    T = TURN.copy()
    T[:3, :3] = change(T)
    with np.errstate(invalid="ignore"), pytest.raises(InputError, match="is not a rigid") as caught:
        pose_from_config({"matrix": T.tolist()})
    assert words in str(caught.value) and "use xyz_m with quat_xyzw" in str(caught.value)


def test_a_matrix_written_by_columns_is_refused_with_its_last_row():
    with pytest.raises(InputError, match=r"last row \[0\.21, 0\.0, 0\.62, 1\.0\], expected"):
        pose_from_config({"matrix": TURN.T.tolist()})


@pytest.mark.parametrize(
    "quat, norm", [([0, 0, 0, 0], "0"), ([0, 0, 1, 1], "1.414"), ([0, 0, 0, 2], "2")]
)
def test_a_quaternion_that_is_not_unit_is_refused_with_its_norm_and_the_remedy(quat, norm):
    with pytest.raises(InputError) as caught:
        pose_from_config({"xyz_m": [0, 0, 0], "quat_xyzw": quat})
    assert (
        str(caught.value)
        == f"quat_xyzw has norm {norm}, expected 1. Write the quaternion as x, y, z, w."
    )


def test_a_wrong_number_of_params_is_refused_in_words():
    block = edited("rig", "sensors.left.params", [812, 810, 651])["sensors"]["left"]
    with pytest.raises(
        InputError, match="params: found 3 numbers; radtan takes fx fy cx cy k1 k2 p1 p2 k3"
    ):
        camera_from_config(block)


def test_a_colour_needs_all_its_ranges(folder):
    content = copy.deepcopy(CYLINDER)
    del content["color"]["value"]
    with pytest.raises(InputError, match="color: missing key value"):
        validate_and_complete("target", content, "cylinder.yaml")


def test_a_template_finer_than_memory_holds_is_refused_with_what_would_do(folder):
    block = copy.deepcopy(CYLINDER) | {"method": "points", "points": {"spacing_m": 1e-12}}
    with pytest.raises(InputError, match="too fine for a target of 0.8 m; expected 0.0004 m"):
        target_from_config(validate_and_complete("target", block, "cylinder.yaml"))


@pytest.mark.parametrize(
    "bias, asked, expected",
    [
        (None, None, True),
        ({"xyz_m": 0.0001, "rpy_deg": 0.01}, None, False),  # the defaults, but stated
        ({"xyz_m": 0.0001, "rpy_deg": 0.01}, True, True),
        (None, False, False),
    ],
)
def test_measured_noise_is_used_where_no_bias_is_stated(folder, bias, asked, expected):
    rig = edited("rig", "mocap.pose_bias_sigma", bias) if bias else copy.deepcopy(RIG)
    if asked is not None:
        rig["mocap"]["use_measured_noise"] = asked
    write(folder / "rigs/husky.yaml", rig)
    rigs = load_config(copy.deepcopy(CONFIG), folder)[1]
    assert rigs["husky"]["mocap"]["use_measured_noise"] is expected


def cut(**more):
    """Sessions of a log whose markers were knocked at 7.5 s."""
    knocked = {"rig": "r", "log": "x", "remounted_at_s": 7.5}
    return validate_and_complete("config", {"sessions": {"s": knocked | more}}, "c")["sessions"]


def test_a_session_is_cut_where_the_markers_of_the_robot_were_knocked():
    both = cut_sessions(cut(from_s=1.0, to_s=20.0), "c")
    assert list(both) == ["s", "s_after"]
    parts = [(p["from_s"], p["to_s"], p["remounted"], p["is_part"]) for p in both.values()]
    assert parts == [(1.0, 7.5, False, True), (7.5, 20.0, True, True)]
    (whole,) = cut_sessions({"t": {"rig": "r", "log": "x"}}, "c").values()
    assert whole["is_part"] is False


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"from_s": 8.0}, "7.5 s; expected a time between from_s 8.0 s and the end of the log"),
        ({"to_s": 5.0}, "7.5 s; expected a time between from_s 0.0 s and to_s 5.0 s"),
    ],
)
def test_a_cut_outside_its_session_is_refused_with_both_times(more, words):
    with pytest.raises(InputError, match=words):
        cut_sessions(cut(**more), "c")


def test_a_cut_whose_later_part_has_a_name_that_is_taken_is_refused():
    sessions = cut() | {"s_after": {"rig": "r", "log": "y"}}
    with pytest.raises(InputError, match=r"sessions\.s_after exists"):
        cut_sessions(sessions, "c")


HUGE_COUNTS = {
    ("config", "crop.max_frames"): 10**12,
    ("config", "solve.max_rounds"): 10**15,
    ("config", "extract.seed"): -1,
    ("config", "guess.seed"): 2**40,
    ("target", "pattern.inner_corners"): [10**6, 10**6],
    ("rig", "sensors.left.size_px"): [10**9, 10**9],
}


@pytest.mark.parametrize("kind, key", HUGE_COUNTS)
def test_a_count_beyond_reason_is_refused_with_its_key(kind, key):
    names = {"config": "config.yaml", "target": "targets/board.yaml", "rig": "rigs/cart.yaml"}
    content = yaml.safe_load(yaml.safe_dump(VALID_FILES[names[kind]]))
    block = content
    for part in key.split(".")[:-1]:
        block = block.setdefault(part, {})
    block[key.split(".")[-1]] = HUGE_COUNTS[kind, key]
    with pytest.raises(InputError, match=f"x.yaml: {key}"):
        validate_and_complete(kind, content, "x.yaml")
