"""Killed, or out of disk, while it writes: the same command again ends with the same bytes.

What happens to a stage is done from outside, by a sitecustomize.py that Python reads before it: the
kernel's limit of a file's size strikes while a file is half written, and there the stage is killed,
alone or with all of the run; or the disk, a small one of memory, is filled when the stage begins.
"""

import os
import shutil
import signal
import subprocess
import time
from contextlib import contextmanager

import pytest

from helpers import small_run
from helpers.small_run import (
    SNAKEMAKE,
    file_digests,
    job_environment,
    run_snakemake,
    run_to_completion,
)

pytestmark = pytest.mark.pipeline

SENSOR, SESSION, RIG = "results/sim/sim/velodyne", "results/sim/sim", "results/sim"
# What every stage writes; the first is asked for.
STAGES = {
    "decode": [f"{SESSION}/{n}" for n in ("mocap.parquet", "frames.parquet", "log.json")],
    "gate": [f"{SESSION}/placements.parquet"],
    "guess": [f"{SENSOR}/guess.json"],
    "crop": [f"{SENSOR}/{n}.parquet" for n in ("moving_views", "views")],
    "extract": [f"{SENSOR}/{n}.parquet" for n in ("moving_keypoints", "keypoints")],
    "associate": [f"{SESSION}/pairs.parquet"],
    "solve": [f"{RIG}/{n}" for n in ("residuals.parquet", "solution.json", "iterations.parquet")],
    "judge": [f"{RIG}/{n}" for n in ("calibration.json", "verdict.json")],
    "report": [f"{RIG}/{n}" for n in ("report.html", "report.pdf", "figures")],
    "export": [f"{RIG}/{n}" for n in ("export/README.md", "export", "history")],
}
SCRIPT = """
import os, resource, signal, sys
if any(a.endswith("scripts/{stage}.py") for a in sys.orig_argv):
"""
KILL = """
    signal.signal(signal.SIGXFSZ, lambda *_: os.{kill}({victim}, signal.SIGKILL))
    resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
"""
FILL = """
    with open("filler", "wb", buffering=0) as filler:
        disk = os.statvfs(".")
        filler.write(bytes(disk.f_bavail * disk.f_bsize - {free}))
"""
VICTIMS = {"job": ("kill", "os.getpid()"), "run": ("killpg", "0")}
FULL = "no space left on the disk. Free some space and run again"
# In a namespace of its own: a run on a small disk, which fills; and one when there is room again.
DISK = """
set -e
disk=$1 finished=$2 full=$3 after=$4
shift 4
mount -t tmpfs -o size=48m tmpfs "$disk"
cp -a "$finished/." "$disk"
if "$@" 2> "$full.err"; then exit 9; fi
cp -a "$disk/results" "$full"
rm "$disk/filler"
PYTHONPATH= "$@" 2> "$after.err"
cp -a "$disk/results" "$after"
"""


def sizes(folder, stage):
    """Bytes of every file that a stage has written."""
    found = [p for name in STAGES[stage] for p in [folder / name, *(folder / name).glob("**/*")]]
    return [p.stat().st_size for p in found if p.is_file()]


def without(folder, stage):
    """Remove what a stage has written."""
    for name in STAGES[stage]:
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def disaster(folder, stage, script, **values):
    """Environment in which Python does something to a stage before it begins."""
    (folder / "sitecustomize.py").write_text((SCRIPT + script).format(stage=stage, **values))
    # No cache of modules: it would meet the limit of sizes first.
    return job_environment() | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}


def command(folder, stage):
    return [SNAKEMAKE, "-s", small_run.ROOT / "Snakefile", "-d", folder, "-c2", STAGES[stage][0]]


def require_whole(folder, finished):
    """No result but in the bytes that a run has which nobody disturbed; the index tells of both."""
    there, expected = file_digests(folder), file_digests(finished)
    there = {k: v for k, v in there.items() if ".part" not in k and not k.endswith("index.html")}
    assert {k: expected.get(k) for k in there} == there


def pieces(folder):
    """What was begun and not finished."""
    return [p for p in (folder / "results").rglob(".*.part")]


# A stage that writes a folder; the others write by the same functions.
KILLED_FAST, FILLED_FAST = ("export",), ()


def stage_params(fast):
    """Parameters of a test over all stages, of which only the fast ones are not marked slow."""
    return [pytest.param(s, marks=() if s in fast else pytest.mark.slow) for s in STAGES]


@pytest.mark.parametrize("victim", ["run", pytest.param("job", marks=pytest.mark.slow)])
@pytest.mark.parametrize("stage", stage_params(KILLED_FAST))
def test_a_stage_killed_while_it_writes_is_made_up_for_by_the_same_command(
    stage, victim, finished_run, finished_run_copy, tmp_path_factory
):
    limit, (kill, who) = max(sizes(finished_run_copy, stage)) // 2, VICTIMS[victim]
    without(finished_run_copy, stage)
    site = tmp_path_factory.mktemp("site")
    env = disaster(site, stage, KILL, kill=kill, victim=who, limit=limit)
    # A process group of its own, for it may die as a whole.
    ended = subprocess.run(
        command(finished_run_copy, stage),
        env=env,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    assert ended.returncode == (1 if victim == "job" else -signal.SIGKILL)
    assert pieces(finished_run_copy)
    require_whole(finished_run_copy, finished_run)
    if victim == "run":
        run_to_completion(finished_run_copy, "--unlock")
    run_to_completion(finished_run_copy, STAGES[stage][0])
    assert file_digests(finished_run_copy) == file_digests(finished_run) and not pieces(
        finished_run_copy
    )


@pytest.fixture(scope="module")
def namespaces():
    """Skips where a user may not mount a disk of his own."""
    words = ["unshare", "-rm", "sh", "-c", "mount -t tmpfs tmpfs /mnt"]
    try:
        done = subprocess.run(words, capture_output=True, text=True)
    except FileNotFoundError:
        pytest.skip("no unshare here: a full disk cannot be made")
    if done.returncode:
        pytest.skip(f"no disk can be mounted here: {done.stderr.strip()}")


@pytest.mark.parametrize("stage", stage_params(FILLED_FAST))
def test_a_disk_that_fills_is_one_clear_line_and_made_up_for_by_the_same_command(
    stage, finished_run, finished_run_copy, namespaces, tmp_path_factory
):
    work = tmp_path_factory.mktemp("disk")
    page, half = os.sysconf("SC_PAGE_SIZE"), max(sizes(finished_run_copy, stage)) // 2
    without(finished_run_copy, stage)
    env = disaster(work, stage, FILL, free=half // page * page)
    for name in ("full", "after"):
        (work / name).mkdir()
    # As deep as the finished run: Snakemake keeps the paths of the code relative to the run.
    disk = tmp_path_factory.mktemp("mnt")
    paths = [disk, finished_run_copy, *(work / n / "results" for n in ("full", "after"))]
    script = ["unshare", "-rm", "sh", "-c", DISK, "sh", *paths, *command(disk, stage)]
    done = subprocess.run(script, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    said = (work / "full/results.err").read_text()
    assert FULL in said and "Traceback" not in said
    require_whole(work / "full", finished_run)
    assert not pieces(work / "full")
    assert file_digests(work / "after") == file_digests(finished_run)


# --- who may run beside whom

HOLD = """
    import time
    while not os.path.exists("go"):
        time.sleep(0.05)
"""


@contextmanager
def held(folder, site, stage="judge"):
    """A run whose one stage waits for a file `go`; with its process."""
    without(folder, stage)
    env = disaster(site, stage, HOLD)
    run = subprocess.Popen(command(folder, stage), env=env, stderr=subprocess.DEVNULL)
    log = folder / f"{RIG}/{stage}.log"
    log.unlink()
    while not log.exists():
        assert run.poll() is None
        time.sleep(0.05)
    yield run
    (folder / "go").touch()
    run.wait()


@pytest.mark.slow
def test_a_run_beside_a_living_one_is_refused(finished_run, finished_run_copy, tmp_path_factory):
    with held(finished_run_copy, tmp_path_factory.mktemp("site")) as run:
        second = run_snakemake(finished_run_copy, STAGES["judge"][0])
        assert second.returncode == 1 and "cannot be locked" in second.stderr
    assert run.returncode == 0 and file_digests(finished_run_copy) == file_digests(finished_run)
