"""What the stages cost, and what the same bytes cost mcap's own reader."""

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
    """Of the jobs of one stage: how many, wall and CPU seconds in sum, the largest memory, MB."""

    n_jobs: int
    wall_s: float
    cpu_s: float
    peak_memory_mb: int


@dataclass(frozen=True)
class RunSpeed:
    """One log to its extrinsics on an otherwise idle machine.

    about: sensors, placements and size of the log in words; costs: {stage: Cost}; wall: s from the
    log to solution.json without Snakemake's own start; raw: CPU s of mcap's own reader on the same
    bytes; memory: [(size of a log, memory of its decode)], MB, over all logs.
    """

    description: str
    stage_costs: dict[str, StageCost]
    wall_s: float
    raw_cpu_s: float
    decode_memory_mb: list[tuple[float, float]]


def parse_stage_costs(log_texts: list[str]) -> dict[str, StageCost]:
    """{stage: Cost} from the texts of the jobs' logs, in the order of the data's flow."""
    found: dict[str, StageCost] = {}
    for text in log_texts:
        for name, wall, cpu, memory in COST_LINE.findall(text):
            before = found.get(name, StageCost(0, 0.0, 0.0, 0))
            found[name] = StageCost(
                before.n_jobs + 1,
                before.wall_s + float(wall),
                before.cpu_s + float(cpu),
                max(before.peak_memory_mb, int(memory)),
            )
    return {name: found[name] for name in TIMED_STAGES if name in found}


def time_raw_read(log_path: Path) -> float:
    """CPU seconds in which mcap's own reader hands out every message of a log, undecoded."""
    begin = time.process_time()
    with log_path.open("rb") as stream:
        for _ in make_reader(stream).iter_messages():
            pass
    return time.process_time() - begin


def describe_machine() -> str:
    """What it runs on, in words."""
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text() if cpuinfo.exists() else ""
    model = re.search(r"^model name\s*: (.*)$", text, re.MULTILINE)
    name = model[1] if model else platform.machine()
    packages = ", ".join(f"{p} {version(p)}" for p in REPORTED_PACKAGES)
    return f"{os.cpu_count()} cores of {name}; Python {platform.python_version()}, {packages}"


def main() -> None:
    """Read the log named on the command line; the stage's log line states the cost."""
    time_raw_read(Path(sys.argv[1]))


if __name__ == "__main__":
    run_stage(main)
