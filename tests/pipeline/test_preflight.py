"""What recordings can support, told after decode and gate: no sensor's data are read for it."""

import json
import shutil

import pytest

from calib.io.parquet_tables import read_table
from calib.io.table_schemas import CAMERA_VIEWS_SCHEMA, LIDAR_VIEWS_SCHEMA
from helpers.small_run import (
    SMALL_ARGUMENTS,
    edit_yaml,
    list_planned_jobs,
    run_snakemake,
    run_to_completion,
    simulate_into,
    simulated_config_path,
    simulated_rig_path,
)

pytestmark = pytest.mark.pipeline

SCHEMAS = {"camera": CAMERA_VIEWS_SCHEMA, "velodyne": LIDAR_VIEWS_SCHEMA}


def preflight(folder):
    """(exit code, preflight.json, preflight.txt, all that the terminal shows) of a recording."""
    run = run_snakemake(folder, "preflight")
    home = folder / "results/sim"
    found = json.loads((home / "preflight.json").read_text())
    return run.returncode, found, (home / "preflight.txt").read_text(), run.stdout + run.stderr


@pytest.fixture(scope="module")
def recorded(small_log, tmp_path_factory):
    """Four placements of a board and of a cylinder, of which the camera sees the board only; not
    run yet."""
    return shutil.copytree(small_log, tmp_path_factory.mktemp("recorded"), dirs_exist_ok=True)


@pytest.fixture(scope="module")
def looked_at(recorded):
    """The recording after a preflight."""
    return recorded, *preflight(recorded)


@pytest.fixture
def copied(recorded, tmp_path):
    """A copy of the recording that a test may spoil."""
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_no_stage_beyond_decode_and_gate_runs(recorded, tmp_path):
    shutil.copytree(
        recorded, tmp_path, ignore=shutil.ignore_patterns("results"), dirs_exist_ok=True
    )
    jobs = {rule for rule, _ in list_planned_jobs(tmp_path, "--", "preflight")}
    assert jobs == {"decode", "gate", "preflight_rig", "preflight"}


def test_a_run_for_results_makes_no_preflight(looked_at):
    assert "preflight_rig" not in {rule for rule, _ in list_planned_jobs(looked_at[0])}


def test_too_few_placements_are_a_warning_in_the_words_of_the_verdict(looked_at):
    _, code, found, _, terminal = looked_at
    assert (code, found["verdict"]) == (0, "warn")
    assert [f["text"] for f in found["findings"]] == ["camera: placements 4, warn below 5"]
    assert "sim: 2 sensors can be calibrated, but:\n  warn: camera: placements 4" in terminal


def test_what_is_seen_is_counted_and_what_is_not_has_its_reason(looked_at):
    about = looked_at[2]["sensors"]
    board, cylinder = (
        about["camera"]["sessions"]["sim"]["targets"][t] for t in ("board", "cylinder")
    )
    assert (board["placements"], board["expected"], board["possible"]) == (4, 4, 4)
    assert (cylinder["possible"], cylinder["not_visible"]) == (0, {"outside the image": 4})
    assert about["velodyne"]["placements"] == {"expected": 8, "possible": 8}
    assert about["camera"]["direction_spread_deg"]["normals"] == pytest.approx(27, abs=2)
    assert about["velodyne"]["direction_spread_deg"]["axes"] == pytest.approx(85, abs=2)


def test_the_counts_are_those_that_crop_then_finds(looked_at):
    folder, _, found, *_ = looked_at
    paths = {s: f"results/sim/sim/{s}" for s in SCHEMAS}
    run_to_completion(
        folder, *(f"{p}/{n}.parquet" for p in paths.values() for n in ("views", "moving_views"))
    )
    for sensor, path in paths.items():
        seen = found["sensors"][sensor]["sessions"]["sim"]["targets"]
        views, _, _ = read_table(folder / path / "views.parquet", SCHEMAS[sensor])
        moving, _, _ = read_table(folder / path / "moving_views.parquet", SCHEMAS[sensor])
        for target, told in seen.items():
            kept = views["placement"][views["kept"] & (views["target"] == target)]
            assert len(set(kept.tolist())) == told["possible"]
            assert (moving["target"] == target).sum() == told["moving_views"]


def test_the_audit_of_the_log_stands_in_the_text(looked_at):
    text = looked_at[3]
    assert "mocap/robot     the robot  521    100 Hz  0.01 s       none" in text
    assert "/tf: time by header; logged 5 ms later" in text
    assert "velodyne: time: time (float32), s after the stamp" in text


def test_of_a_pose_that_is_stated_nowhere_the_placements_are_an_upper_bound(copied):
    edit_yaml(simulated_rig_path(copied), lambda r: r["sensors"]["camera"].pop("T_robot_sensor"))
    code, found, text, _ = preflight(copied)
    assert code == 0
    assert found["sensors"]["camera"]["placements"] == {"expected": None, "possible": 8}
    assert "the pose of camera in sim is not stated: it is estimated from the data" in text
    assert "at most 8" in text


def test_of_a_target_whose_mount_is_unknown_the_placements_are_an_upper_bound(copied):
    edit_yaml(copied / "config/targets/board.yaml", lambda t: t.update(mount="unknown"))
    code, found, text, _ = preflight(copied)
    seen = found["sensors"]["camera"]["sessions"]["sim"]["targets"]
    assert code == 0
    assert (seen["board"]["expected"], seen["board"]["possible"]) == (None, 4)
    assert (seen["cylinder"]["expected"], seen["cylinder"]["possible"]) == (0, 0)
    assert "the mount of board in its body is not stated: it is estimated from the data" in text


def test_without_an_offset_to_find_no_motion_is_asked_for(copied):
    settings = {"estimate": {"time_offset": False}}
    crop = {"max_moving_views": 0}
    edit_yaml(simulated_config_path(copied), lambda c: c.update(solve=settings, crop=crop))
    _, found, *_ = preflight(copied)
    assert {s["moving_views"] for s in found["sensors"].values()} == {0}
    assert all(f["check"] != "time_offset_s" for f in found["findings"])


def test_a_sensor_that_is_not_in_the_log_is_named_and_the_other_is_calibrated(copied):
    edit_yaml(
        simulated_rig_path(copied), lambda r: r["sensors"]["camera"].update(topic="/camera/image")
    )
    code, found, _, terminal = preflight(copied)
    assert (code, found["levels"]) == (0, {"camera": "fail", "velodyne": "pass"})
    assert "sim: 1 sensor can be calibrated, not camera" in terminal
    assert "fail: camera: topic /camera/image is not in the log" in terminal
    assert "Did you mean /camera/image_raw?" in terminal


def test_a_body_that_the_motion_capture_does_not_know_stops_all_and_is_told_once(copied):
    edit_yaml(simulated_rig_path(copied), lambda r: r.update(body="mocap/husky"))
    code, found, text, terminal = preflight(copied)
    assert (code, found["verdict"]) == (1, "fail")
    assert "sim: THESE RECORDINGS CANNOT BE CALIBRATED" in terminal
    assert text.count("MCS body mocap/husky is not in the log") == 3  # two tables, one finding
    (finding,) = found["findings"]
    assert finding["sensors"] == ["camera", "velodyne"]


@pytest.mark.slow
def test_after_a_preflight_that_failed_nothing_is_said_to_have_stopped(copied):
    edit_yaml(simulated_rig_path(copied), lambda r: r.update(body="mocap/husky"))
    preflight(copied)
    edit_yaml(simulated_rig_path(copied), lambda r: r.update(body="mocap/robot"))
    code, _, _, terminal = preflight(copied)
    assert code == 0 and "STOPPED" not in terminal


def test_a_board_mounted_the_wrong_way_round_is_seen_from_behind(copied):
    turned = {"xyz_m": [0, 0, 0], "rpy_deg": [0, 180, 0]}
    edit_yaml(copied / "config/targets/board.yaml", lambda t: t.update(T_body_target=turned))
    code, found, *_ = preflight(copied)
    (finding,) = [f for f in found["findings"] if f["check"] == "status"]
    assert code == 0 and finding["sensors"] == ["camera"]
    assert finding["text"].endswith("4 outside the image, 4 seen from behind")
    assert finding["remedy"].startswith("Turn T_body_target of the board")


def test_messages_from_another_time_than_the_poses_fail(copied):
    def late(rig):
        for sensor in rig["sensors"].values():
            sensor["time_offset_s"] = 3600

    edit_yaml(simulated_rig_path(copied), late)
    code, found, *_ = preflight(copied)
    assert code == 1
    told = {f["text"].split(";")[0] for f in found["findings"]}
    assert told == {
        f"{n}: no message of {n} has a time at which the motion capture knows the robot's pose"
        for n in ("camera", "velodyne")
    }


@pytest.mark.slow
def test_one_placement_at_rest_supports_nothing(tmp_path):
    arguments = SMALL_ARGUMENTS.replace("--placements 4", "--placements 1")
    code, found, *_ = preflight(simulate_into(tmp_path, arguments))
    told = [(f["level"], f["text"]) for f in found["findings"]]
    motion = "time offset not observable: no relative motion in its view"
    assert code == 1 and told == [
        ("fail", "camera: placements 1, fail below 3"),
        ("fail", "velodyne: placements 2, fail below 3"),
        ("warn", f"camera: {motion}"),
        ("warn", f"velodyne: {motion}"),
    ]


@pytest.mark.slow
def test_turns_about_one_axis_only_ask_to_tilt_the_target(tmp_path):
    """Robot and board turn about the vertical, the board's y."""
    arguments = SMALL_ARGUMENTS.replace("--placements 4", "--placements 6")
    folder = simulate_into(tmp_path, f"{arguments} --targets board --upright")
    code, found, text, _ = preflight(folder)
    (finding,) = found["findings"]
    assert code == 0 and finding["check"] == "target_mount"
    assert "T_body_target of board is undetermined in translation along y" in finding["text"]
    most, second, least = found["targets"]["board"]["rotation_spread_deg"]
    assert most > 10 and second < 0.1 and least < 0.1
    assert "board   6          17°, 0°, 0°" in text
