"""Running the pipeline as a user does, and logs to run it on."""

import hashlib
import json
import os
import re
import shlex
import subprocess
import sys
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import yaml

import simulate

ROOT = Path(__file__).parents[2]
SNAKEMAKE = Path(sys.executable).with_name("snakemake")
SMALL_ARGUMENTS = "--placements 4 --hold-s 0.8 --move-s 0.6 --sector-deg 60 --camera-hz 5 --seed 3"


def simulate_into(folder, arguments):
    """A folder with a simulated log, its config and its truth."""
    simulate.main([str(folder), *arguments.split()])
    return folder


def job_environment():
    """Return the environment of a run: no activated Python, the BLAS kernels of this process.

    Another kernel adds in another order, so stages in this process and in jobs must use the same.
    """
    blas = ("OMP_", "OPENBLAS_", "MKL_", "BLIS_", "NVPL_")
    kept = {k: v for k, v in os.environ.items() if k.startswith(blas)}
    return {"PATH": "/usr/bin:/bin"} | kept


def run_snakemake(folder, *arguments):
    """Run Snakemake on a folder, without an activated environment; returns the finished process."""
    command = [SNAKEMAKE, "-s", ROOT / "Snakefile", "-d", folder, "--cores", "2", *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=job_environment())


def run_to_completion(folder, *arguments):
    """Run Snakemake and require that it ends well."""
    run = run_snakemake(folder, *arguments)
    assert run.returncode == 0, run.stdout + run.stderr
    return run


def list_planned_jobs(folder, *arguments):
    """Count the jobs that a run would execute, as (rule, sensor or "")."""
    run = run_to_completion(folder, "-n", "--quiet", "host", *arguments)
    jobs = re.findall(r"^Job \d+: (\w+) (\S+)", run.stdout + run.stderr, flags=re.MULTILINE)
    sensors = (places.split("/")[2:] or [""] for _, places in jobs)
    return Counter((rule, sensor[0]) for (rule, _), sensor in zip(jobs, sensors, strict=True))


def edit_yaml(path, change):
    """Apply a function to the content of a YAML file."""
    content = yaml.safe_load(path.read_text())
    change(content)
    path.write_text(yaml.safe_dump(content, sort_keys=False))


def simulated_config_path(folder):
    """config.yaml of a simulated recording."""
    return folder / "config" / "config.yaml"


def simulated_rig_path(folder):
    """The rig of a simulated recording."""
    return folder / "config" / "rigs" / "sim.yaml"


def list_job_commands(folder):
    """{(rule, sensor or ""): arguments of its script} of all jobs, as a person would paste them."""
    run = run_to_completion(folder, "-n", "-F", "--printshellcmds", "--quiet", "host")
    found = {}
    for line in (run.stdout + run.stderr).splitlines():
        if line.startswith("Shell command: ") and "--options" in line:
            words = shlex.split(line.removeprefix("Shell command: ").rsplit(" 2> ", 1)[0])
            words = words[words.index("python") :]  # after the limit of memory
            options = json.loads(words[words.index("--options") + 1])
            found[Path(words[1]).stem, options.get("name", "")] = words[2:]
    return found


def file_digests(folder):
    """SHA-256 of every result, logs apart."""
    results = sorted(
        p for p in (folder / "results").rglob("*") if p.is_file() and p.suffix != ".log"
    )
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in results}


def load_common_rules(settings):
    """Return the names of the workflow's files, for the content of config.yaml of this folder."""
    workflow = SimpleNamespace(basedir=ROOT, dag_settings=SimpleNamespace(targets=set()))
    names = {"workflow": workflow, "shell": MagicMock(), "config": settings}
    names["is_disk_full"] = lambda: False  # of startup_checks.smk
    for name in ("common.smk", "run_summary.smk"):
        path = ROOT / "workflow" / name
        exec(compile(path.read_text(), path, "exec"), names)
    return names
