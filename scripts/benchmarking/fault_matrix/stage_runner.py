"""Run the stages of a folder's rig in this process, from the first one whose arguments changed."""

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import associate
import crop
import decode
import extract
import gate
import guess
import judge
import solve
from calib.io.status import InputError

ROOT = Path(__file__).parents[3]
STAGES: tuple[ModuleType, ...] = (
    decode, gate, guess, crop, extract, associate, solve, judge,
)  # fmt: skip
DRAWN_STAGES = ("solve", "judge")  # those that a draw runs again


class StageJob(NamedTuple):
    """One job of the pipeline: its stage, and the arguments of its script."""

    stage: ModuleType
    arguments: list[str]


class StageRun(NamedTuple):
    """The jobs of a folder in their order, and why they stopped, "" if they did not."""

    jobs: list[StageJob]
    stopped: str


def list_stage_jobs(folder: Path) -> list[StageJob]:
    """Return all jobs of a folder's rig up to its verdict, in an order in which they can run.

    Raises InputError with Snakemake's last lines if the config is refused.
    """
    command = [str(Path(sys.executable).with_name("snakemake")), "-s", str(ROOT / "Snakefile")]
    command += [
        "-d",
        str(folder),
        "--cores",
        "1",
        "-n",
        "-F",
        "--printshellcmds",
        "--quiet",
        "host",
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    text = done.stdout + done.stderr
    if done.returncode:
        raise InputError(" ".join(text.strip().splitlines()[-3:]))
    by_name = {stage.__name__: i for i, stage in enumerate(STAGES)}
    found = []
    for line in re.findall(r"^Shell command: .*?(python \S*\.py .*--options .*)$", text, re.M):
        words = shlex.split(line.rsplit(" 2> ", 1)[0])
        name = Path(words[1]).stem
        if name in by_name:
            found.append((by_name[name], words[2:]))
    return [StageJob(STAGES[i], words) for i, words in sorted(found, key=lambda f: f[0])]


def run_stages(folder: Path, jobs: list[StageJob], done: list[StageJob] | None = None) -> StageRun:
    """Run jobs in a folder; done: those whose results are there, of another config perhaps.

    A job runs if its arguments are not among those done, or if a job of an earlier stage ran.
    """
    known = {_job_key(job) for job in done or []}
    with working_directory(folder):
        for number, job in enumerate(jobs):
            if _job_key(job) in known:
                continue
            later = [j for j in jobs[number:] if _must_run(j, job, known)]
            return StageRun(jobs, _run_all(later))
    return StageRun(jobs, "")


def _must_run(job: StageJob, first: StageJob, known: set[str]) -> bool:
    """Return whether a job runs after the first that runs: a later stage, or itself changed."""
    return STAGES.index(job.stage) > STAGES.index(first.stage) or _job_key(job) not in known


def _job_key(job: StageJob) -> str:
    return json.dumps([job.stage.__name__, job.arguments])


def _run_all(jobs: list[StageJob]) -> str:
    """Run jobs; return why they stopped, "" if they did not."""
    for job in jobs:
        make_output_folders(job.arguments)
        try:
            job.stage.main(job.arguments)
        except InputError as error:
            return str(error)
    return ""


def make_output_folders(arguments: list[str]) -> None:
    """Make the folders of all result files among the arguments of a stage."""
    for word in arguments:
        if word.startswith("results/"):
            Path(word).parent.mkdir(parents=True, exist_ok=True)


@contextmanager
def working_directory(folder: Path) -> Iterator[None]:
    """Be in a folder, to which the paths of jobs are relative."""
    here = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(here)


def select_jobs(jobs: list[StageJob], name: str) -> list[StageJob]:
    """Return the jobs of one stage."""
    return [job for job in jobs if job.stage.__name__ == name]
