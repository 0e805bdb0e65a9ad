"""Cost of the stages from their logs, and the time of mcap's own reader."""

import os
import platform
import re
import sys
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from mcap.reader import make_reader

from calib.io.stage_cli import run_stage

COST_LINE = re.compile(r"^(\w+) took ([\d.]+) s, ([\d.]+) s CPU, (\d+) MB$", re.MULTILINE)
TIMED_STAGES = ("decode", "gate", "guess", "crop", "extract", "associate", "solve", "judge")
REPORTED_PACKAGES = (
    "snakemake",
    "numpy",
    "scipy",
    "casadi",
    "opencv-python-headless",
    "mcap",
    "pyarrow",
)


@dataclass(frozen=True)
class StageCost:
    """Cost of all jobs of one stage: number, summed wall and CPU times, largest memory of a job."""

    n_jobs: int
    wall_s: float
    cpu_s: float
    peak_memory_mb: int


@dataclass(frozen=True)
class RunSpeed:
    """Cost of one run from log to extrinsics.

    description: sensors, placements and size of the log in words; stage_costs: by stage; wall_s:
    from the log to solution.json without the start of Snakemake; raw_cpu_s: CPU time of mcap's own
    reader on the same log; decode_memory_mb: (size, peak memory of decode) of every log, MB.
    """

    description: str
    stage_costs: dict[str, StageCost]
    wall_s: float
    raw_cpu_s: float
    decode_memory_mb: list[tuple[float, float]]


def parse_stage_costs(log_texts: list[str]) -> dict[str, StageCost]:
    """Sum the costs by stage from the texts of job logs, in the order of the pipeline."""
    costs: dict[str, StageCost] = {}
    for text in log_texts:
        for name, wall, cpu, memory in COST_LINE.findall(text):
            before = costs.get(name, StageCost(0, 0.0, 0.0, 0))
            costs[name] = StageCost(
                before.n_jobs + 1,
                before.wall_s + float(wall),
                before.cpu_s + float(cpu),
                max(before.peak_memory_mb, int(memory)),
            )
    return {name: costs[name] for name in TIMED_STAGES if name in costs}


def time_raw_read(log_path: Path) -> float:
    """Return the CPU seconds that mcap's own reader takes to read a log without decoding."""
    begin = time.process_time()
    with log_path.open("rb") as stream:
        for _ in make_reader(stream).iter_messages():
            pass
    return time.process_time() - begin


def describe_machine() -> str:
    """Describe processor, Python and packages in words."""
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text() if cpuinfo.exists() else ""
    model = re.search(r"^model name\s*: (.*)$", text, re.MULTILINE)
    name = model[1] if model else platform.machine()
    packages = ", ".join(f"{p} {version(p)}" for p in REPORTED_PACKAGES)
    return f"{os.cpu_count()} cores of {name}; Python {platform.python_version()}, {packages}"


def main() -> None:
    """Read the log given on the command line; run_stage logs the cost."""
    time_raw_read(Path(sys.argv[1]))


if __name__ == "__main__":
    run_stage(main)
