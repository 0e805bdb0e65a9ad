"""What a fault of the data or the config does: one clear message, and nothing healthy is lost."""

import html
import json
import shutil

import numpy as np
import pytest

from benchmarking.fuzzing.random_configs import ALIAS_BOMB
from helpers.small_run import (
    edit_yaml,
    run_snakemake,
    run_to_completion,
    simulated_config_path,
    simulated_rig_path,
)

pytestmark = pytest.mark.pipeline

VERDICT = "results/sim/verdict.json"


def verdict(folder):
    return json.loads((folder / VERDICT).read_text())


def calibration(folder):
    return json.loads((folder / "results/sim/calibration.json").read_text())


@pytest.mark.slow
def test_a_missing_topic_fails_that_sensor_with_the_nearest_name_and_keeps_the_other(
    finished_run, finished_run_copy
):
    edit_yaml(
        simulated_rig_path(finished_run_copy),
        lambda r: r["sensors"]["camera"].update(topic="/camera/image_rwa"),
    )
    run = run_snakemake(finished_run_copy)
    assert run.returncode == 1
    result = calibration(finished_run_copy)
    status = result["sensors"]["camera"]["status"]
    assert status["reason"] == "topic /camera/image_rwa is not in the log"
    assert "/camera/image_raw" in status["remedy"]
    assert result["sensors"]["camera"]["T_robot_sensor"] is None
    healthy = calibration(finished_run)["sensors"]["velodyne"]["T_robot_sensor"]["xyz_m"]
    assert result["sensors"]["velodyne"]["T_robot_sensor"]["xyz_m"] == pytest.approx(
        healthy, abs=2e-6
    )
    assert not (finished_run_copy / "results/sim/export").exists()
    assert "topic /camera/image_rwa is not in the log" in run.stderr.split("sim: FAIL")[1]


@pytest.mark.slow
def test_a_lens_that_no_camera_info_tells_fails_that_camera_in_words_and_keeps_the_lidar(
    finished_run_copy,
):
    def ask(r):
        for key in ("model", "size_px", "params"):
            del r["sensors"]["camera"][key]
        r["sensors"]["camera"]["camera_info"] = "/camera/info"

    edit_yaml(simulated_rig_path(finished_run_copy), ask)
    run_snakemake(finished_run_copy)
    sensors = calibration(finished_run_copy)["sensors"]
    status = sensors["camera"]["status"]
    assert status["reason"] == "no CameraInfo on /camera/info"
    assert status["found"] == "CameraInfo on /camera/camera_info"
    assert sensors["camera"]["T_robot_sensor"] is None
    assert sensors["velodyne"]["T_robot_sensor"] is not None
    page = (finished_run_copy / "results/sim/report.html").read_text()
    assert "no CameraInfo on /camera/info" in page
    assert "time (float32), s after the stamp: 0.0 to" in page


@pytest.mark.slow
def test_an_unseen_target_body_is_named_and_the_other_target_serves(finished_run_copy):
    edit_yaml(
        finished_run_copy / "config/targets/cylinder.yaml",
        lambda t: t.update(body="mocap/cylindre"),
    )
    run_to_completion(finished_run_copy, VERDICT)
    audit = json.loads((finished_run_copy / "results/sim/sim/log.json").read_text())
    status = audit["bodies"]["mocap/cylindre"]["status"]
    assert status["reason"] == "MCS body mocap/cylindre is not in the log"
    assert "mocap/cylinder" in status["remedy"]
    assert calibration(finished_run_copy)["sensors"]["velodyne"]["placements"] == 4


@pytest.mark.slow
def test_an_unseen_robot_body_fails_every_sensor_in_words(finished_run_copy):
    edit_yaml(simulated_rig_path(finished_run_copy), lambda r: r.update(body="mocap/robto"))
    run_to_completion(finished_run_copy, VERDICT)
    assert verdict(finished_run_copy)["verdict"] == "fail"
    for sensor in calibration(finished_run_copy)["sensors"].values():
        assert sensor["status"]["reason"] == "MCS body mocap/robto is not in the log"
        assert "mocap/robot" in sensor["status"]["remedy"]
        assert sensor["T_robot_sensor"] is None


@pytest.mark.slow
def test_a_sensor_without_a_view_says_why_and_keeps_the_other(finished_run_copy):
    away = {"xyz_m": [0.2, 0.0, 0.6], "rpy_deg": [0, 180, 0]}
    edit_yaml(
        simulated_rig_path(finished_run_copy),
        lambda r: r["sensors"]["camera"].update(T_robot_sensor=away),
    )
    run_to_completion(finished_run_copy, VERDICT)
    result = calibration(finished_run_copy)["sensors"]
    status = result["camera"]["status"]
    assert status["reason"] == (
        "T_robot_sensor of camera does not agree with what camera saw, but a pose 0.19 m and "
        "119 deg away does"
    )
    assert status["found"] == "the pattern agrees with that at 4 of 4 placements"
    assert status["remedy"].startswith("Set sensors.camera.T_robot_sensor to {xyz_m: [")
    assert result["velodyne"]["status"]["ok"]


@pytest.mark.slow
def test_a_board_that_is_stated_the_wrong_way_round_says_which_way_is_right(finished_run_copy):
    turned = {"xyz_m": [0, 0, 0], "rpy_deg": [0, 180, 0]}
    edit_yaml(
        finished_run_copy / "config/targets/board.yaml", lambda t: t.update(T_body_target=turned)
    )
    run_to_completion(finished_run_copy, VERDICT)
    status = calibration(finished_run_copy)["sensors"]["camera"]["status"]
    assert status["reason"].startswith("T_body_target of board does not agree with what camera")
    assert status["remedy"].startswith("Set T_body_target of board to {xyz_m: [")


@pytest.mark.slow
def test_a_pattern_that_was_printed_mirrored_says_so_on_the_first_screen(finished_run_copy):
    """Of a board with an odd and an even number of squares, a mirror swaps black and white."""
    board = finished_run_copy / "config/targets/board.yaml"
    edit_yaml(board, lambda t: t["pattern"].update(first_square="white"))
    run_to_completion(finished_run_copy, VERDICT, "results/sim/report.html")
    sensors = calibration(finished_run_copy)["sensors"]
    status = sensors["camera"]["status"]
    assert (
        status["reason"] == "camera sees the pattern of board the other way round than configured"
    )
    assert status["found"] == "the pattern agrees with that at 4 of 4 placements"
    assert status["remedy"].startswith("Set first_square of board to black.")
    assert "printed or mounted mirrored" in status["remedy"]
    assert sensors["velodyne"]["T_robot_sensor"] is not None
    page = html.unescape((finished_run_copy / "results/sim/report.html").read_text())
    banner = page[page.index('class="banner') : page.index("</dl>")]
    assert status["reason"] in banner and status["remedy"] in banner


@pytest.mark.slow
def test_a_sensor_that_cannot_be_found_says_what_to_record_or_write_and_keeps_the_other(
    finished_run_copy,
):
    edit_yaml(
        simulated_rig_path(finished_run_copy),
        lambda r: r["sensors"]["camera"].pop("T_robot_sensor"),
    )
    # The cylinder of this recording is never before the camera.
    edit_yaml(finished_run_copy / "config/targets/board.yaml", lambda t: t.pop("pattern"))
    run_to_completion(finished_run_copy, VERDICT)
    result = calibration(finished_run_copy)["sensors"]
    status = result["camera"]["status"]
    assert status["reason"] == "no initial guess for camera: no pose found in the data"
    assert status["found"].startswith("coloured body found at 0 of 4 placements")
    assert "Hold the target still at 4 or more different places" in status["remedy"]
    assert "sensors.camera.T_robot_sensor" in status["remedy"]
    assert result["velodyne"]["status"]["ok"]


@pytest.mark.slow
def test_a_log_cut_short_is_calibrated_from_what_is_there_and_the_report_says_so(
    finished_run, finished_run_copy
):
    log = finished_run_copy / "logs/sim.mcap"
    size = round(0.8 * log.stat().st_size)
    log.write_bytes(log.read_bytes()[:size])
    run_to_completion(finished_run_copy, VERDICT, "results/sim/report.html")
    (fault,) = json.loads((finished_run_copy / "results/sim/sim/log.json").read_text())["faults"]
    assert fault.startswith("sim.mcap: breaks off after byte ") and f" of {size} " in fault
    assert fault in html.unescape((finished_run_copy / "results/sim/report.html").read_text())
    before, after = (
        calibration(f)["sensors"]["velodyne"] for f in (finished_run, finished_run_copy)
    )
    assert 2 <= after["placements"] < before["placements"]
    shift = np.subtract(*(s["T_robot_sensor"]["xyz_m"] for s in (before, after)))
    assert np.linalg.norm(shift) < 1e-3


def test_a_log_that_cannot_be_read_is_one_line_with_the_file_and_the_remedy(finished_run_copy):
    log = finished_run_copy / "logs/sim.mcap"
    log.write_bytes(bytes(100_000))
    run = run_snakemake(finished_run_copy)
    assert run.returncode == 1
    last = run.stderr.split("sim: STOPPED")[1]
    assert "logs/sim.mcap: not a readable MCAP file" in last and "mcap doctor" in last
    assert "Traceback" not in run.stderr
    assert not list((finished_run_copy / "results/sim/sim").glob("*.part"))


def test_a_missing_log_is_named_before_anything_runs(finished_run_copy):
    (finished_run_copy / "logs/sim.mcap").unlink()
    shutil.rmtree(finished_run_copy / "results")
    run = run_snakemake(finished_run_copy)
    assert run.returncode == 1
    assert "logs/sim.mcap: no such log" in run.stdout + run.stderr


def test_a_wrong_key_is_refused_with_its_path_and_the_nearest_name(finished_run_copy):
    edit_yaml(
        simulated_rig_path(finished_run_copy),
        lambda r: r["sensors"]["velodyne"].update(range_sigma=0.01),
    )
    run = run_snakemake(finished_run_copy)
    text = run.stdout + run.stderr
    assert run.returncode == 1
    assert "config/rigs/sim.yaml: sensors.velodyne: unknown key range_sigma" in text
    assert "Did you mean range_sigma_m?" in text


@pytest.mark.slow
def test_a_failed_verdict_removes_stale_exports_and_says_why_last(finished_run_copy):
    assert (finished_run_copy / "results/sim/export/static_transforms.yaml").exists()
    edit_yaml(
        simulated_config_path(finished_run_copy),
        lambda c: c.update(judge={"fail_placements": 99, "warn_placements": 99}),
    )
    run = run_snakemake(finished_run_copy)
    assert run.returncode == 1
    assert not (finished_run_copy / "results/sim/export").exists()
    assert (finished_run_copy / "results/sim/report.html").exists()
    assert "camera: placements 4, fail below 99" in run.stderr.split("sim: FAIL")[1]


@pytest.mark.slow
def test_a_log_that_changed_after_decode_is_refused_by_crop(finished_run_copy):
    (finished_run_copy / "results/sim/sim/velodyne/views.parquet").unlink()
    audit = finished_run_copy / "results/sim/sim/log.json"
    content = json.loads(audit.read_text())
    content["fingerprint"] = ["sim.mcap 1 0"]
    audit.write_text(json.dumps(content))
    run = run_snakemake(
        finished_run_copy, "results/sim/sim/velodyne/views.parquet", "--allowed-rules", "crop"
    )
    assert run.returncode == 1
    assert "changed since it was decoded" in run.stderr


@pytest.mark.parametrize(
    "text, words",
    [
        (ALIAS_BOMB, "expands to more than 100000 values"),
        ("sessions: {a: {rig: sim, log: x}}\nsessions: {}", "key 'sessions' appears in line 1"),
        ("sessions: \x1b[2J", "not valid YAML"),
    ],
)
def test_a_config_that_is_none_is_one_line_before_anything_runs(finished_run_copy, text, words):
    simulated_config_path(finished_run_copy).write_text(text)
    run = run_snakemake(finished_run_copy)
    assert run.returncode == 1 and f"config/config.yaml: {words}" in run.stderr
    assert "Traceback" not in run.stderr and "\x1b" not in run.stderr
