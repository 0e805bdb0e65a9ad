"""Compare the cost of decode with that of mcap's own reader, on the same logs."""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from benchmarking.decode_cost import large_logs
from benchmarking.decode_cost.large_logs import BODY_NAMES, large_log_sensors, write_large_log
from benchmarking.decode_cost.process_cost import COST_LINE, StageCost
from benchmarking.page.markdown import PageSection, format_markdown_table, format_two_digits
from calib.io.logs.open_log import fingerprint_log

SCRIPTS_FOLDER = Path(__file__).parents[2]
MAX_CPU_RATIO = 1.5  # goal: CPU time of decode over that of mcap's own reader
MAX_MEMORY_MB = 500  # goal
BYTES_PER_GB = 1e9
DECODE_INTRO = """Logs that repeat a few scans and images with new stamps: 3 bodies at 100 Hz, two
lidars of 28 800 points and two cameras of 1280 × 1024 px at 10 Hz. decode is compared with mcap's
own reader, which reads every message without decoding it. Both run on the same logs, each in its
own process; times include the start of Python."""


@dataclass(frozen=True)
class DecodeCostRow:
    """The cost of reading one log.

    compression: of its chunks; content_bytes: size of all messages; raw_cost: of mcap's own reader.
    """

    compression: str
    content_bytes: float
    n_messages: int
    decode_cost: StageCost
    raw_cost: StageCost

    @property
    def cpu_ratio(self) -> float:
        """CPU time of decode over that of mcap's own reader; both include the start of Python."""
        return self.decode_cost.cpu_s / self.raw_cost.cpu_s


def plan_decode_logs(is_quick: bool) -> list[tuple[str, float]]:
    """Return (compression, bytes of messages) of the logs, the large log last."""
    small, large = (
        (0.2 * BYTES_PER_GB, BYTES_PER_GB) if is_quick else (BYTES_PER_GB, 10 * BYTES_PER_GB)
    )
    return [("none", small), ("lz4", small), ("zstd", small), ("none", large)]


def measure_decode_costs(folder: Path, is_quick: bool) -> list[DecodeCostRow]:
    """Write each planned log into a folder, measure its readers, and remove it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "ingest.mcap"
    return [measure_one_log(path, *log_plan) for log_plan in plan_decode_logs(is_quick)]


def measure_one_log(path: Path, compression: str, content_bytes: float) -> DecodeCostRow:
    """Write a log at path, measure its readers, and remove it."""
    try:
        n_messages = write_large_log(path, compression, content_bytes)
        raw = run_and_parse_cost("-m", "benchmarking.decode_cost.process_cost", path)
        decode = run_and_parse_cost(SCRIPTS_FOLDER / "decode.py", *decode_arguments(path))
    finally:
        path.unlink(missing_ok=True)
    return DecodeCostRow(compression, content_bytes, n_messages, decode, raw)


def decode_arguments(path: Path) -> tuple[str | Path, ...]:
    """Return the arguments of scripts/decode.py for a large log; outputs go into its folder."""
    mocap = {"topics": ["/tf"], "map": large_logs.MAP_FRAME, "max_gap_s": 0.05}
    mocap |= {"unit": "auto", "quaternions": "auto"}
    options = {
        "log": str(path),
        "fingerprint": fingerprint_log(str(path)),
        "sensors": large_log_sensors(),
        "mocap": mocap,
        "bodies": list(BODY_NAMES),
        "from_s": None,
        "to_s": None,
    }
    names = {"mocap": "mocap.parquet", "frames": "frames.parquet", "audit": "log.json"}
    outputs = [word for k, name in names.items() for word in (f"--{k}", path.parent / name)]
    return *outputs, "--options", json.dumps(options)


def run_and_parse_cost(*command: str | Path) -> StageCost:
    """Run a Python script and return the cost from its log.

    Raises RuntimeError if it fails.
    """
    # Started by a shell, because a process inherits the peak memory of its parent.
    words = ["/bin/sh", "-c", '"$@"; exit $?', "sh", sys.executable, *command]
    done = subprocess.run(
        [str(w) for w in words], cwd=SCRIPTS_FOLDER, capture_output=True, text=True
    )
    match = COST_LINE.search(done.stderr)
    if done.returncode or not match:
        raise RuntimeError(f"{command[0]} did not read its log:\n{done.stderr}")
    wall, cpu, memory = match.groups()[1:]
    return StageCost(1, float(wall), float(cpu), int(memory))


def build_decode_section(rows: list[DecodeCostRow]) -> PageSection:
    """Return the section of the page on decoding."""
    return PageSection(
        "Decoding", f"{DECODE_INTRO}\n\n{format_decode_table(rows)}", check_decode_goals(rows)
    )


def format_decode_table(rows: list[DecodeCostRow]) -> str:
    """Return the table of decode costs."""
    head = (
        "chunks",
        "messages, GB",
        "messages",
        "decode, CPU s",
        "MB/s",
        "messages/s",
        "peak, MB",
        "mcap's reader, CPU s",
        "MB/s",
        "messages/s",
        "peak, MB",
        "decode / reader",
    )
    return format_markdown_table(head, [_decode_cells(r) for r in rows])


def _decode_cells(row: DecodeCostRow) -> list[str]:
    cells = [
        row.compression,
        format_two_digits(row.content_bytes / BYTES_PER_GB),
        str(row.n_messages),
    ]
    for c in (row.decode_cost, row.raw_cost):
        speed = f"{row.content_bytes / 1e6 / c.cpu_s:.0f}", f"{row.n_messages / c.cpu_s:.0f}"
        cells += [format_two_digits(c.cpu_s), *speed, str(c.peak_memory_mb)]
    return [*cells, format_two_digits(row.cpu_ratio)]


def check_decode_goals(rows: list[DecodeCostRow]) -> list[str]:
    """Return one sentence for each goal that a row misses.

    Small logs have no goal for the time: most of it is the start of Python.
    """
    out = []
    for r in rows:
        size_gb = format_two_digits(r.content_bytes / BYTES_PER_GB)
        name = f"decode of {size_gb} GB, chunks {r.compression}"
        if r.content_bytes >= BYTES_PER_GB and not r.cpu_ratio <= MAX_CPU_RATIO:
            ratio = format_two_digits(r.cpu_ratio)
            out.append(f"{name}: {ratio} × mcap's own reader, goal {MAX_CPU_RATIO} ×")
        if not r.decode_cost.peak_memory_mb <= MAX_MEMORY_MB:
            out.append(f"{name}: {r.decode_cost.peak_memory_mb} MB, goal {MAX_MEMORY_MB} MB")
    return out
