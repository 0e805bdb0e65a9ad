"""Each stage's main() by hand on a simulated log without noise, against the truth."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import associate
import crop
import decode
import export
import extract
import gate
import guess
import judge
import report
import solve
from calib.geometry.se3 import invert_pose, pose_from_xyz_quat, se3_log, transform_points
from calib.io.config import validate_and_complete
from calib.io.parquet_tables import read_table, select_rows
from calib.io.pose_block import pose_from_config, pose_sigma_from_config
from calib.io.safe_yaml import load_yaml
from calib.io.stage_cli import read_json, run_stage, write_json
from calib.io.status import InputError
from calib.io.table_schemas import (
    CAMERA_VIEWS_SCHEMA,
    FRAMES_SCHEMA,
    LIDAR_VIEWS_SCHEMA,
    MOCAP_SCHEMA,
    PAIRS_SCHEMA,
    PLACEMENTS_SCHEMA,
    RESIDUALS_SCHEMA,
)
from calib.mocap.body_trajectory import relative_trajectory, trajectory_from_columns
from calib.mocap.stillness import trajectory_speeds
from calib.sensors.sensor_models import camera_from_config
from calib.targets.target_shapes import target_from_config
from helpers.small_run import list_job_commands

HOME = "results/sim/sim"


@pytest.fixture(scope="module")
def by_hand(small_log, tmp_path_factory):
    """A simulated log taken through all stages in this process, with the commands that did it."""
    folder = shutil.copytree(small_log, tmp_path_factory.mktemp("hand"), dirs_exist_ok=True)
    commands = list_job_commands(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name in ("sim/camera", "sim/velodyne", "figures"):
            (folder / "results/sim" / name).mkdir(parents=True)
        decode.main(commands["decode", ""])
        gate.main(commands["gate", ""])
        for sensor in ("camera", "velodyne"):
            for module, name in ((guess, "guess"), (crop, "crop"), (extract, "extract")):
                module.main(commands[name, sensor])
        for module in (associate, solve, judge, report, export):
            module.main(commands[module.__name__, ""])
    return folder, commands


@pytest.fixture
def here(by_hand, monkeypatch):
    folder, commands = by_hand
    monkeypatch.chdir(folder)
    return commands


@pytest.fixture
def truth(here):
    return json.loads(Path("truth.json").read_text())


def matrix(pose):
    return np.array(pose["matrix"])


def test_decode_finds_every_message_and_pose(here):
    audit = read_json(f"{HOME}/log.json")
    poses, _, _ = read_table(f"{HOME}/mocap.parquet", MOCAP_SCHEMA)
    frames, _, _ = read_table(f"{HOME}/frames.parquet", FRAMES_SCHEMA)
    count = {t: v["messages"] for t, v in audit["topics"].items()}
    assert len(poses["stamp_ns"]) == 3 * count["/tf"]
    assert (poses["fault"] == "").all()
    assert np.sum(frames["sensor"] == "camera") == count["/camera/image_raw"]
    assert np.sum(frames["sensor"] == "velodyne") == count["/velodyne_points"]
    assert audit["bodies"]["mocap/board"]["rate_hz"] == pytest.approx(100, rel=0.01)
    assert audit["sensors"]["velodyne"]["frame"] == "velodyne"


def test_gate_finds_the_placements_and_their_poses_to_a_nanometre(here, truth):
    found, status, notes = read_table(f"{HOME}/placements.parquet", PLACEMENTS_SCHEMA)
    assert status.ok and all(n["ok"] for n in notes["targets"].values())
    for name in ("board", "cylinder"):
        rows = np.flatnonzero((found["target"] == name) & (found["kind"] == "still"))
        assert len(rows) == len(truth["placements"]) == 4
        for i, place in zip(rows, truth["placements"], strict=True):
            assert place["start_ns"] <= found["start_ns"][i] < found["end_ns"][i] <= place["end_ns"]
            T = pose_from_xyz_quat(found["xyz"][i], found["quat"][i])
            error = se3_log(invert_pose(matrix(place["T_robot_target"][name])) @ T)
            assert np.abs(error).max() < 1e-9


def test_guess_passes_on_the_rig_s_own(here):
    found = read_json(f"{HOME}/camera/guess.json")
    written = load_yaml("config/rigs/sim.yaml")["sensors"]["camera"]
    assert found["source"] == "config"
    np.testing.assert_allclose(
        matrix(found["T_robot_sensor"]), pose_from_config(written["T_robot_sensor"])
    )
    np.testing.assert_allclose(found["sigma"], pose_sigma_from_config(written["guess_sigma"]))


def test_guess_takes_the_chain_of_static_transforms_where_the_rig_states_nothing(here, tmp_path):
    arguments = list(here["guess", "camera"])
    options = json.loads(arguments[-1])
    del options["sensor"]["T_robot_sensor"]
    audit = read_json(f"{HOME}/log.json")
    quarter = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
    audit["static"] = [
        {
            "parent": "mocap/robot",
            "child": "base",
            "T": {"xyz_m": [1.0, 0, 0], "quat_xyzw": quarter},
        },
        {
            "parent": "camera",
            "child": "base",
            "T": {"xyz_m": [0, 0, 2.0], "quat_xyzw": [0, 0, 0, 1]},
        },
    ]
    write_json(tmp_path / "log.json", audit)
    output = tmp_path / "guess.json"
    paths = ["--audit", str(tmp_path / "log.json"), "--mocap", "--placements", "--frames"]
    paths += ["--output", str(output)]
    guess.main([*paths, "--options", json.dumps(options)])
    found = read_json(output)
    assert found["source"] == "tf_static"
    np.testing.assert_allclose(found["T_robot_sensor"]["xyz_m"], [1, 0, -2], atol=1e-12)
    np.testing.assert_allclose(found["T_robot_sensor"]["quat_xyzw"], quarter, atol=1e-12)


def test_crop_accounts_for_every_frame_and_keeps_none_that_moves(here, truth):
    frames, _, _ = read_table(f"{HOME}/frames.parquet", FRAMES_SCHEMA)
    for sensor, schema in (
        ("camera", CAMERA_VIEWS_SCHEMA),
        ("velodyne", LIDAR_VIEWS_SCHEMA),
    ):
        views, status, _ = read_table(f"{HOME}/{sensor}/views.parquet", schema)
        assert status.ok
        assert len(views["view"]) == 2 * np.sum(frames["sensor"] == sensor)
        assert ((views["reason"] == "") == views["kept"]).all()
        for i in np.flatnonzero(views["kept"]):
            spans = [(p["start_ns"], p["end_ns"]) for p in truth["placements"]]
            last = (
                views["stamp_ns"][i] + max(views["point_time_ns"][i])
                if sensor == "velodyne"
                else views["stamp_ns"][i]
            )
            assert any(a <= views["stamp_ns"][i] and last <= b for a, b in spans)


def test_extracted_corners_are_those_of_the_board_to_0_02_px(here, truth):
    pairs, _, _ = read_table(f"{HOME}/pairs.parquet", PAIRS_SCHEMA)
    rows = select_rows(pairs, pairs["kind"] == "pattern_corner")
    config = validate_and_complete("rig", load_yaml("config/rigs/sim.yaml"), "rig")["sensors"][
        "camera"
    ]
    board = validate_and_complete("target", load_yaml("config/targets/board.yaml"), "board")
    corners = target_from_config(board).pattern.corners()
    T_robot_camera = matrix(truth["sensors"]["camera"]["T_robot_sensor"])
    errors = []
    for place in truth["placements"]:
        at = (rows["stamp_ns"] >= place["start_ns"]) & (rows["stamp_ns"] <= place["end_ns"])
        T = invert_pose(T_robot_camera) @ matrix(place["T_robot_target"]["board"])
        uv, _ = camera_from_config(config).project(
            transform_points(T, corners[rows["candidate_feature"][at]])
        )
        errors.append(rows["uv"][at] - uv)
    errors = np.concatenate(errors)
    assert len(errors) == len(rows["stamp_ns"]) and (rows["candidate_feature"] >= 0).all()
    assert np.sqrt((errors**2).mean()) < 0.02


def test_members_of_a_lidar_lie_on_the_targets_to_3_micrometres(here, truth):
    pairs, _, _ = read_table(f"{HOME}/pairs.parquet", PAIRS_SCHEMA)
    T_robot_lidar = matrix(truth["sensors"]["velodyne"]["T_robot_sensor"])
    for name in ("board", "cylinder"):
        target = target_from_config(
            validate_and_complete("target", load_yaml(f"config/targets/{name}.yaml"), name)
        )
        mine = (pairs["target"] == name) & (pairs["kind"] == "target_surface") & pairs["is_inlier"]
        seen = 0
        for place in truth["placements"]:
            at = (
                mine
                & (pairs["stamp_ns"] >= place["start_ns"])
                & (pairs["stamp_ns"] <= place["end_ns"])
            )
            if at.any():
                seen += 1
                T = invert_pose(matrix(place["T_robot_target"][name])) @ T_robot_lidar
                distance = target.surface_distance(*transform_points(T, pairs["xyz"][at]).T)
                assert np.median(np.abs(distance)) < 1e-6
                assert np.mean(np.abs(distance) < 3e-6) > 0.99
        assert mine.sum() > 1000
        assert seen >= 3  # one cylinder of this log gives the lidar no return


def test_judge_writes_what_the_schemas_promise(here):
    for kind in ("calibration", "verdict"):
        content = read_json(f"results/sim/{kind}.json")
        validate_and_complete(kind, content, kind)


def test_residuals_have_one_row_per_pair(here):
    pairs, _, _ = read_table(f"{HOME}/pairs.parquet", PAIRS_SCHEMA)
    residuals, _, _ = read_table("results/sim/residuals.parquet", RESIDUALS_SCHEMA)
    assert np.sum(~residuals["is_moving"]) == len(pairs["sensor"])


def test_residuals_of_targets_in_motion_come_with_their_speed(here):
    residuals, _, _ = read_table("results/sim/residuals.parquet", RESIDUALS_SCHEMA)
    moving = residuals["is_moving"]
    assert moving.any() and np.all(residuals["speed_mps"][~moving] == 0)
    assert residuals["speed_mps"][moving].min() > 0 and residuals["speed_mps"][moving].max() < 2
    member = residuals["weight"] > 0
    r = residuals["value"][moving & member, 0] / residuals["sigma"][moving & member]
    assert np.sqrt(np.mean(r**2)) < 3


def test_still_intervals_are_numbered_first(here):
    found, _, _ = read_table(f"{HOME}/placements.parquet", PLACEMENTS_SCHEMA)
    still = found["kind"] == "still"
    assert found["placement"][still].tolist() == list(range(8))
    assert found["placement"].tolist() == list(range(len(still)))


def test_export_writes_the_transform_that_calibration_json_states(here):
    text = Path("results/sim/export/static_transforms.yaml").read_text()
    exported = load_yaml("results/sim/export/static_transforms.yaml")["transforms"]
    result = read_json("results/sim/calibration.json")["sensors"]
    assert [t["child_frame_id"] for t in exported] == ["camera", "velodyne"]
    for t, name in zip(exported, ("camera", "velodyne"), strict=True):
        move, turn = t["transform"]["translation"], t["transform"]["rotation"]
        T = pose_from_xyz_quat([move[k] for k in "xyz"], [turn[k] for k in "xyzw"])
        np.testing.assert_allclose(T, matrix(result[name]["T_robot_sensor"]), atol=1e-12)
        x, y, z = T[:3, 0] + T[:3, 3]
        assert f"the point (1, 0, 0) of {name} is ({x:.6f}, {y:.6f}, {z:.6f})" in text


def test_export_refuses_a_failed_verdict_and_removes_what_stood_there(here, tmp_path):
    calibration = read_json("results/sim/calibration.json")
    write_json(tmp_path / "c.json", calibration)
    write_json(tmp_path / "v.json", {"verdict": "fail", "reasons": ["velodyne: too bad"]})
    old = tmp_path / "export" / "README.md"
    old.parent.mkdir()
    old.write_text("stale")
    arguments = ["--calibration", tmp_path / "c.json", "--verdict", tmp_path / "v.json"]
    arguments += ["--frames", "--placements", "--guesses", "--views", "--urdf"]
    arguments += ["--output", old.parent, "--history", tmp_path / "history"]
    arguments += ["--options", here["export", ""][-1]]
    with pytest.raises(InputError, match="velodyne: too bad"):
        export.main([str(a) for a in arguments])
    assert not old.exists()
    assert not (tmp_path / "history").exists()


def test_an_accepted_calibration_is_kept_and_a_second_export_adds_nothing(here):
    (entry,) = Path("results/sim/history").iterdir()
    before = entry.read_bytes()
    calibration = read_json("results/sim/calibration.json")
    assert read_json(entry)["calibration"] == calibration
    export.main(here["export", ""])
    assert [p.read_bytes() for p in Path("results/sim/history").iterdir()] == [before]


def test_a_wrong_input_ends_a_stage_in_one_line_and_exit_code_1(here, caplog):
    arguments = list(here["crop", "camera"])
    options = json.loads(arguments[-1]) | {"log": "logs/nowhere.mcap"}
    arguments[-1] = json.dumps(options)
    with pytest.raises(SystemExit) as end:
        run_stage(lambda: crop.main(arguments))
    assert end.value.code == 1
    said = [r for r in caplog.records if r.levelname == "ERROR"]
    assert len(said) == 1 and said[0].exc_info is None
    assert said[0].getMessage().startswith("error: logs/nowhere.mcap: no such log")


def test_still_intervals_leave_out_the_moves(here):
    poses, _, _ = read_table(f"{HOME}/mocap.parquet", MOCAP_SCHEMA)
    robot, board = (trajectory_from_columns(poses, f"mocap/{b}", 0.05) for b in ("robot", "board"))
    linear, _ = trajectory_speeds(relative_trajectory(robot, board), 0.3)
    assert np.mean(linear[np.isfinite(linear)] > 0.01) > 0.3


def test_a_static_transform_that_is_no_pose_is_a_status_and_no_crash(here, tmp_path):
    arguments = list(here["guess", "camera"])
    options = json.loads(arguments[-1])
    del options["sensor"]["T_robot_sensor"]
    audit = read_json(f"{HOME}/log.json")
    broken = {"xyz_m": [0, 0, 0], "quat_xyzw": [0, 0, 0, 0]}
    audit["static"] = [{"parent": "mocap/robot", "child": "camera", "T": broken}]
    write_json(tmp_path / "log.json", audit)
    output = tmp_path / "guess.json"
    paths = ["--audit", str(tmp_path / "log.json"), "--mocap", "--placements", "--frames"]
    paths += ["--output", str(output)]
    guess.main([*paths, "--options", json.dumps(options)])
    found = read_json(output)
    assert found["T_robot_sensor"] is None
    assert found["status"]["reason"] == "a static transform of the log is not a rigid motion"


def test_decode_takes_only_what_lies_between_from_s_and_to_s(here, tmp_path):
    options = json.loads(here["decode", ""][-1])
    outputs = [str(tmp_path / n) for n in ("mocap", "frames", "log.json")]
    names = ("--mocap", "--frames", "--audit")
    paths = [word for pair in zip(names, outputs, strict=True) for word in pair]
    decode.main([*paths, "--options", json.dumps(options | {"from_s": 1.0, "to_s": 3.0})])
    frames, _, _ = read_table(outputs[1], FRAMES_SCHEMA)
    log_t = frames["log_time_ns"][frames["sensor"] == "velodyne"]
    assert len(log_t) == pytest.approx(20, abs=1)
    assert np.ptp(log_t) <= 2e9
