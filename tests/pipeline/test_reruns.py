"""What re-runs what, and that a run leaves the same bytes whatever happened to it."""

import json
import os
import shutil
import signal
import subprocess
import time

import pytest
import yaml

from helpers import small_run
from helpers.small_run import (
    SNAKEMAKE,
    edit_yaml,
    job_environment,
    list_job_commands,
    list_planned_jobs,
    load_common_rules,
    run_snakemake,
    run_to_completion,
    simulated_config_path,
    simulated_rig_path,
)

pytestmark = pytest.mark.pipeline

AFTER_EXTRACT = {"associate", "solve", "judge", "report", "export"}
SENSOR_STAGES = {"guess", "crop", "extract"}
ALL = {"decode", "gate"} | SENSOR_STAGES | AFTER_EXTRACT


def rules(jobs):
    return {rule for rule, _ in jobs}


def test_a_finished_run_plans_nothing(finished_run):
    assert not list_planned_jobs(finished_run)


def test_a_report_option_re_runs_the_report_alone(finished_run_copy):
    edit_yaml(
        simulated_config_path(finished_run_copy), lambda c: c.update(report={"max_overlays": 2})
    )
    assert rules(list_planned_jobs(finished_run_copy)) == {"report"}


def test_a_limit_of_judge_re_runs_three_jobs(finished_run_copy):
    edit_yaml(
        simulated_config_path(finished_run_copy), lambda c: c.update(judge={"warn_placements": 4})
    )
    assert rules(list_planned_jobs(finished_run_copy)) == {"judge", "report", "export"}


def test_a_solve_option_re_runs_from_solve_on(finished_run_copy):
    edit_yaml(
        simulated_config_path(finished_run_copy), lambda c: c.update(solve={"max_rounds": 29})
    )
    assert rules(list_planned_jobs(finished_run_copy)) == {"solve", "judge", "report", "export"}


def test_the_noise_of_one_lidar_re_runs_its_own_jobs_and_what_follows(finished_run_copy):
    edit_yaml(
        simulated_rig_path(finished_run_copy),
        lambda r: r["sensors"]["velodyne"].update(range_sigma_m=0.03),
    )
    jobs = list_planned_jobs(finished_run_copy)
    assert {s for r, s in jobs if r in SENSOR_STAGES} == {"velodyne"}
    assert rules(jobs) == SENSOR_STAGES | AFTER_EXTRACT


def test_the_size_of_a_target_re_runs_neither_decode_nor_gate_nor_guess(finished_run_copy):
    target = finished_run_copy / "config/targets/cylinder.yaml"
    edit_yaml(target, lambda t: t.update(radius_m=0.11))
    assert rules(list_planned_jobs(finished_run_copy)) == {"crop", "extract"} | AFTER_EXTRACT


def test_a_guess_depends_on_targets_and_log_only_where_pose_or_clock_is_to_be_found(
    finished_run_copy,
):
    edit_yaml(
        simulated_rig_path(finished_run_copy),
        lambda r: r["sensors"]["camera"].pop("T_robot_sensor"),
    )
    commands = list_job_commands(finished_run_copy)
    searched, timed = (commands["guess", s] for s in ("camera", "velodyne"))
    edit_yaml(
        simulated_config_path(finished_run_copy),
        lambda c: c.update(solve={"estimate": {"time_offset": False}}),
    )
    stated = list_job_commands(finished_run_copy)["guess", "velodyne"]
    assert {"targets", "log"} <= set(json.loads(searched[-1]))
    assert {"targets", "log"} & set(json.loads(timed[-1])) == {"log"}
    assert not {"targets", "log", "bodies"} & set(json.loads(stated[-1]))
    assert "results/sim/sim/placements.parquet" in searched
    assert "results/sim/sim/placements.parquet" not in timed
    assert "results/sim/sim/mocap.parquet" in timed
    assert not {f"results/sim/sim/{n}.parquet" for n in ("mocap", "frames")} & set(stated)


def test_a_touched_log_re_runs_nothing(finished_run_copy):
    (finished_run_copy / "logs/sim.mcap").touch()
    assert not list_planned_jobs(finished_run_copy)


def test_a_copied_log_re_runs_nothing(finished_run_copy):
    log = finished_run_copy / "logs/sim.mcap"
    copy = shutil.copyfile(log, finished_run_copy / "copy")
    log.unlink()
    copy.rename(log)
    assert not list_planned_jobs(finished_run_copy)


def test_a_changed_log_re_runs_everything(finished_run_copy):
    with (finished_run_copy / "logs/sim.mcap").open("ab") as stream:
        stream.write(b"\0")
    assert rules(list_planned_jobs(finished_run_copy)) == ALL


def test_defaults_written_out_re_run_nothing(finished_run_copy):
    edit_yaml(
        simulated_config_path(finished_run_copy), lambda c: c.update(gate={"trim_s": 0.1}, solve={})
    )
    assert not list_planned_jobs(finished_run_copy)


@pytest.mark.slow
def test_a_second_run_from_nothing_gives_the_same_bytes(finished_run, finished_run_copy):
    shutil.rmtree(finished_run_copy / "results")
    shutil.rmtree(finished_run_copy / ".snakemake")
    run_to_completion(finished_run_copy)
    assert small_run.file_digests(finished_run_copy) == small_run.file_digests(finished_run)


@pytest.mark.slow
def test_a_killed_run_started_again_ends_with_the_same_bytes(finished_run, finished_run_copy):
    shutil.rmtree(finished_run_copy / "results")
    shutil.rmtree(finished_run_copy / ".snakemake")
    command = [
        SNAKEMAKE,
        "-s",
        small_run.ROOT / "Snakefile",
        "-d",
        finished_run_copy,
        "--cores",
        "2",
    ]
    run = subprocess.Popen(
        command, start_new_session=True, stderr=subprocess.DEVNULL, env=job_environment()
    )
    crop = finished_run_copy / "results/sim/sim/velodyne/crop.log"
    while not crop.exists():
        assert run.poll() is None
        time.sleep(0.05)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    locked = run_snakemake(finished_run_copy)
    assert locked.returncode == 1 and "--unlock" in " ".join(locked.stderr.splitlines()[-3:])
    run_to_completion(finished_run_copy, "--unlock")
    run_to_completion(finished_run_copy)
    assert small_run.file_digests(finished_run_copy) == small_run.file_digests(finished_run)


def test_the_code_of_a_stage_is_what_importing_it_loads(finished_run, monkeypatch):
    """find_stage_code() follows imports; a change of a file that it missed would re-run nothing."""
    probe = (
        "import sys, {stage}; from pathlib import Path; root = Path({stage}.__file__).parent;"
        "print(*sorted(str(Path(m.__file__).relative_to(root)) for m in list(sys.modules.values())"
        " if getattr(m, '__file__', None) and Path(m.__file__).is_relative_to(root)"
        " and '.venv' not in m.__file__))"
    )
    monkeypatch.chdir(finished_run)
    settings = yaml.safe_load(simulated_config_path(finished_run).read_text())
    find_stage_code = load_common_rules(settings)["find_stage_code"]
    for stage in sorted(ALL):
        listed = {p.split("scripts/", 1)[1] for p in find_stage_code(stage)}
        command = [small_run.sys.executable, "-c", probe.format(stage=stage)]
        loaded = subprocess.run(
            command, capture_output=True, text=True, cwd=small_run.ROOT / "scripts"
        )
        assert loaded.returncode == 0, loaded.stderr
        assert set(loaded.stdout.split()) - {f"{stage}.py"} <= listed, stage


def test_the_truth_reaches_no_job_but_the_report(finished_run):
    """Nothing that another job is given holds a pose of the truth or the file of them."""
    found = {rule: " ".join(words) for (rule, _), words in list_job_commands(finished_run).items()}
    assert set(found) == ALL
    assert {rule for rule, words in found.items() if "truth" in words} == {"report"}
    poses = yaml.safe_load(simulated_rig_path(finished_run).read_text())["truth"].values()
    for rule in sorted(ALL - {"report"}):
        assert not any(str(p["xyz_m"][0]) in found[rule] for p in poses), rule
