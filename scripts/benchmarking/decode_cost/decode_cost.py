"""What decode costs beside mcap's own reader, on the same bytes and in the same run."""

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
MAX_CPU_RATIO, MAX_MEMORY_MB = 1.5, 500  # goals: CPU time over that of mcap's own reader; MB
BYTES_PER_GB = 1e9
DECODE_INTRO = """Logs that repeat a few scans and images with fresh stamps: 3 bodies at 100 Hz, two
lidars of 28 800 points and two cameras of 1280 × 1024 px at 10 Hz. decode and mcap's own reader,
which hands out every message undecoded, take turns on the same bytes, each in a process of its own;
start of Python included."""


@dataclass(frozen=True)
class DecodeCostRow:
    """One log: compression of its chunks, bytes of its messages and how many these are; the
    cost.Cost of decode, and of mcap's own reader."""

    compression: str
    content_bytes: float
    n_messages: int
    decode_cost: StageCost
    raw_cost: StageCost

    @property
    def cpu_ratio(self) -> float:
        """CPU time of decode over that of mcap's own reader, start of Python included in both."""
        return self.decode_cost.cpu_s / self.raw_cost.cpu_s


def plan_decode_logs(is_quick: bool) -> list[tuple[str, float]]:
    """[(compression, bytes of messages)] of the rows, the large log last."""
    small, large = (
        (0.2 * BYTES_PER_GB, BYTES_PER_GB) if is_quick else (BYTES_PER_GB, 10 * BYTES_PER_GB)
    )
    return [("none", small), ("lz4", small), ("zstd", small), ("none", large)]


def measure_decode_costs(folder: Path, is_quick: bool) -> list[DecodeCostRow]:
    """[Row] of the plan; each log is written below a folder, read, and removed."""
    folder.mkdir(parents=True, exist_ok=True)
    return [measure_one_log(folder / "ingest.mcap", *of) for of in plan_decode_logs(is_quick)]


def measure_one_log(path: Path, compression: str, content_bytes: float) -> DecodeCostRow:
    """The Row of a log at path."""
    try:
        messages = write_large_log(path, compression, content_bytes)
        raw = run_and_parse_cost("-m", "benchmarking.decode_cost.process_cost", path)
        decode = run_and_parse_cost(SCRIPTS_FOLDER / "decode.py", *decode_arguments(path))
    finally:
        path.unlink(missing_ok=True)
    return DecodeCostRow(compression, content_bytes, messages, decode, raw)


def decode_arguments(path: Path) -> tuple[str | Path, ...]:
    """Of scripts/decode.py, for a log of `repeated`; its outputs go beside it."""
    mocap = {"topics": ["/tf"], "map": large_logs.MAP_FRAME, "max_gap_s": 0.05}
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
    written = [word for k, name in names.items() for word in (f"--{k}", path.parent / name)]
    return *written, "--options", json.dumps(options)


def run_and_parse_cost(*command: str | Path) -> StageCost:
    """The Cost that a script of this checkout says it had."""
    # A shell in between: a process inherits the peak memory of the one that starts it.
    words = ["/bin/sh", "-c", '"$@"; exit $?', "sh", sys.executable, *command]
    done = subprocess.run(
        [str(w) for w in words], cwd=SCRIPTS_FOLDER, capture_output=True, text=True
    )
    found = COST_LINE.search(done.stderr)
    if done.returncode or not found:
        raise RuntimeError(f"{command[0]} did not read its log:\n{done.stderr}")
    wall, cpu, memory = found.groups()[1:]
    return StageCost(1, float(wall), float(cpu), int(memory))


def build_decode_section(rows: list[DecodeCostRow]) -> PageSection:
    """The Section on Rows."""
    return PageSection(
        "Decoding", f"{DECODE_INTRO}\n\n{format_decode_table(rows)}", check_decode_goals(rows)
    )


def format_decode_table(rows: list[DecodeCostRow]) -> str:
    """The table of Rows."""
    head: tuple[str, ...] = (
        "chunks",
        "messages, GB",
        "messages",
        "decode, CPU s",
        "MB/s",
        "messages/s",
        "peak, MB",
    )
    head += ("mcap's reader, CPU s", "MB/s", "messages/s", "peak, MB", "decode / reader")
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
