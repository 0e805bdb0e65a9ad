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

from calib.io import stage_cli

LINE = re.compile(r"^(\w+) took ([\d.]+) s, ([\d.]+) s CPU, (\d+) MB$", re.MULTILINE)
STAGES = ("decode", "gate", "guess", "crop", "extract", "associate", "solve", "judge")
PACKAGES = ("snakemake", "numpy", "scipy", "casadi", "opencv-python-headless", "mcap", "pyarrow")


@dataclass(frozen=True)
class Cost:
    """Of the jobs of one stage: how many, wall and CPU seconds in sum, the largest memory, MB."""

    jobs: int
    wall: float
    cpu: float
    memory: int


@dataclass(frozen=True)
class Speed:
    """One log to its extrinsics on an otherwise idle machine.

    about: sensors, placements and size of the log in words; costs: {stage: Cost}; wall: s from the
    log to solution.json without Snakemake's own start; raw: CPU s of mcap's own reader on the same
    bytes; memory: [(size of a log, memory of its decode)], MB, over all logs.
    """

    about: str
    costs: dict
    wall: float
    raw: float
    memory: list


def costs(logs):
    """{stage: Cost} from the texts of the jobs' logs, in the order of the data's flow."""
    found = {}
    for text in logs:
        for name, wall, cpu, memory in LINE.findall(text):
            before = found.get(name, Cost(0, 0.0, 0.0, 0))
            found[name] = Cost(
                before.jobs + 1,
                before.wall + float(wall),
                before.cpu + float(cpu),
                max(before.memory, int(memory)),
            )
    return {name: found[name] for name in STAGES if name in found}


def raw_read(log):
    """CPU seconds in which mcap's own reader hands out every message of a log, undecoded."""
    begin = time.process_time()
    with log.open("rb") as stream:
        for _ in make_reader(stream).iter_messages():
            pass
    return time.process_time() - begin


def machine():
    """What it runs on, in words."""
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text() if cpuinfo.exists() else ""
    model = re.search(r"^model name\s*: (.*)$", text, re.MULTILINE)
    name = model[1] if model else platform.machine()
    packages = ", ".join(f"{p} {version(p)}" for p in PACKAGES)
    return f"{os.cpu_count()} cores of {name}; Python {platform.python_version()}, {packages}"


if __name__ == "__main__":
    stage_cli.run(lambda: raw_read(Path(sys.argv[1])))
