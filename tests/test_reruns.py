"""What re-runs what, and that a run leaves the same bytes whatever happened to it."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import time

import yaml

import runs
from runs import config, rig

AFTER_EXTRACT = {"associate", "solve", "judge", "report", "export"}
SENSOR_STAGES = {"guess", "crop", "extract"}
ALL = {"decode", "gate"} | SENSOR_STAGES | AFTER_EXTRACT


def rules(jobs):
    return {rule for rule, _ in jobs}


def digests(folder):
    """SHA-256 of every result, logs apart."""
    results = sorted(
        p for p in (folder / "results").rglob("*") if p.is_file() and p.suffix != ".log"
    )
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in results}


def test_a_finished_run_plans_nothing(finished):
    assert not runs.planned(finished)


def test_a_report_option_re_runs_the_report_alone(again):
    runs.edit(config(again), lambda c: c.update(report={"max_overlays": 2}))
    assert rules(runs.planned(again)) == {"report"}


def test_a_limit_of_judge_re_runs_three_jobs(again):
    runs.edit(config(again), lambda c: c.update(judge={"warn_placements": 4}))
    assert rules(runs.planned(again)) == {"judge", "report", "export"}


def test_a_solve_option_re_runs_from_solve_on(again):
    runs.edit(config(again), lambda c: c.update(solve={"max_rounds": 29}))
    assert rules(runs.planned(again)) == {"solve", "judge", "report", "export"}


def test_the_noise_of_one_lidar_re_runs_its_own_jobs_and_what_follows(again):
    runs.edit(rig(again), lambda r: r["sensors"]["velodyne"].update(range_sigma_m=0.03))
    jobs = runs.planned(again)
    assert {s for r, s in jobs if r in SENSOR_STAGES} == {"velodyne"}
    assert rules(jobs) == SENSOR_STAGES | AFTER_EXTRACT


def test_the_size_of_a_target_re_runs_neither_decode_nor_gate_nor_guess(again):
    target = again / "config/targets/cylinder.yaml"
    runs.edit(target, lambda t: t.update(radius_m=0.11))
    assert rules(runs.planned(again)) == {"crop", "extract"} | AFTER_EXTRACT


def test_a_guess_depends_on_targets_and_log_only_where_pose_or_clock_is_to_be_found(again):
    runs.edit(rig(again), lambda r: r["sensors"]["camera"].pop("T_robot_sensor"))
    commands = runs.commands(again)
    searched, timed = (commands["guess", s] for s in ("camera", "velodyne"))
    runs.edit(config(again), lambda c: c.update(solve={"estimate": {"time_offset": False}}))
    stated = runs.commands(again)["guess", "velodyne"]
    assert {"targets", "log"} <= set(json.loads(searched[-1]))
    assert {"targets", "log"} & set(json.loads(timed[-1])) == {"log"}
    assert not {"targets", "log", "bodies"} & set(json.loads(stated[-1]))
    assert "results/sim/sim/placements.parquet" in searched
    assert "results/sim/sim/placements.parquet" not in timed
    assert "results/sim/sim/mocap.parquet" in timed
    assert not {f"results/sim/sim/{n}.parquet" for n in ("mocap", "frames")} & set(stated)


def test_a_touched_log_re_runs_nothing(again):
    (again / "logs/sim.mcap").touch()
    assert not runs.planned(again)


def test_a_copied_log_re_runs_nothing(again):
    log = again / "logs/sim.mcap"
    copy = shutil.copyfile(log, again / "copy")
    log.unlink()
    copy.rename(log)
    assert not runs.planned(again)


def test_a_changed_log_re_runs_everything(again):
    with (again / "logs/sim.mcap").open("ab") as stream:
        stream.write(b"\0")
    assert rules(runs.planned(again)) == ALL


def test_defaults_written_out_re_run_nothing(again):
    runs.edit(config(again), lambda c: c.update(gate={"trim_s": 0.1}, solve={}))
    assert not runs.planned(again)


def test_a_second_run_from_nothing_gives_the_same_bytes(finished, again):
    shutil.rmtree(again / "results")
    shutil.rmtree(again / ".snakemake")
    runs.completed(again)
    assert digests(again) == digests(finished)


def test_a_killed_run_started_again_ends_with_the_same_bytes(finished, again):
    shutil.rmtree(again / "results")
    shutil.rmtree(again / ".snakemake")
    command = [runs.SNAKEMAKE, "-s", runs.ROOT / "Snakefile", "-d", again, "--cores", "2"]
    run = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    crop = again / "results/sim/sim/velodyne/crop.log"
    while not crop.exists():
        assert run.poll() is None
        time.sleep(0.05)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    runs.completed(again)
    assert digests(again) == digests(finished)


def test_the_code_of_a_stage_is_what_importing_it_loads(finished):
    """code() follows import statements; a file that it missed would not re-run its stages."""
    probe = (
        "import sys, {stage}; from pathlib import Path; root = Path({stage}.__file__).parent;"
        "print(*sorted(str(Path(m.__file__).relative_to(root)) for m in list(sys.modules.values())"
        " if getattr(m, '__file__', None) and Path(m.__file__).is_relative_to(root)"
        " and '.venv' not in m.__file__))"
    )
    text = runs.completed(finished, "-n", "-F", "--quiet", "host").stdout
    for stage in sorted(ALL):
        job = text.split(f"rule {stage}:")[1].split("output:")[0]
        listed = {
            p.split("scripts/", 1)[1] for p in job.replace("\n", ",").split(",") if "scripts/" in p
        }
        command = [runs.sys.executable, "-c", probe.format(stage=stage)]
        loaded = subprocess.run(command, capture_output=True, text=True, cwd=runs.ROOT / "scripts")
        assert loaded.returncode == 0, loaded.stderr
        assert set(loaded.stdout.split()) - {f"{stage}.py"} <= listed, stage


def test_the_truth_reaches_no_job_but_the_report(finished):
    """Nothing that another job is given holds a pose of the truth or the file of them."""
    found = {rule: " ".join(words) for (rule, _), words in runs.commands(finished).items()}
    assert set(found) == ALL
    assert {rule for rule, words in found.items() if "truth" in words} == {"report"}
    poses = yaml.safe_load(runs.rig(finished).read_text())["truth"].values()
    for rule in sorted(ALL - {"report"}):
        assert not any(str(p["xyz_m"][0]) in found[rule] for p in poses), rule
