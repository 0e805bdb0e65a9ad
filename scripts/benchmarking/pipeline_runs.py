"""Simulate a log into a folder, and make files of the pipeline there."""

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def simulate_log(folder: Path, arguments: Sequence[str], has_kept_logs: bool) -> None:
    """Simulate one log with its truth into a folder, unless it is there and has_kept_logs."""
    if has_kept_logs and (folder / "truth.json").exists():
        return
    command = [sys.executable, str(ROOT / "scripts" / "simulate.py"), str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"simulation of {folder.name} failed:\n{done.stderr}")


def make_with_snakemake(run_folder: Path, targets: Sequence[str], cores: int) -> tuple[bool, float]:
    """Make targets in a working directory; return whether all were made, and the seconds."""
    command = [
        str(Path(sys.executable).with_name("snakemake")),
        "-s",
        str(ROOT / "Snakefile"),
        "-d",
        str(run_folder),
    ]
    command += ["--cores", str(cores), "--keep-going", "--", *targets]
    begin = time.perf_counter()
    with (run_folder / "snakemake.log").open("a") as log:
        done = subprocess.run(command, stdout=log, stderr=log).returncode == 0
    return done, time.perf_counter() - begin
