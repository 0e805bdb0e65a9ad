"""What decode costs beside mcap's own reader, on the same bytes and in the same run."""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from benchmarking.decode_cost import large_logs, process_cost
from benchmarking.page.markdown import Section, digits, table
from calib.io.logs import open_log

SCRIPTS = Path(__file__).parents[2]
RATIO, MEMORY = 1.5, 500  # goals: CPU time over that of mcap's own reader; MB
GB = 1e9
WORDS = """Logs that repeat a few scans and images with fresh stamps: 3 bodies at 100 Hz, two
lidars of 28 800 points and two cameras of 1280 × 1024 px at 10 Hz. decode and mcap's own reader,
which hands out every message undecoded, take turns on the same bytes, each in a process of its own;
start of Python included."""


@dataclass(frozen=True)
class Row:
    """One log: compression of its chunks, bytes of its messages and how many these are; the
    cost.Cost of decode, and of mcap's own reader."""

    compression: str
    content: float
    messages: int
    decode: process_cost.Cost
    raw: process_cost.Cost

    @property
    def ratio(self):
        """CPU time of decode over that of mcap's own reader, start of Python included in both."""
        return self.decode.cpu / self.raw.cpu


def plan(quick):
    """[(compression, bytes of messages)] of the rows, the large log last."""
    small, large = (0.2 * GB, GB) if quick else (GB, 10 * GB)
    return [("none", small), ("lz4", small), ("zstd", small), ("none", large)]


def measured(folder, quick):
    """[Row] of the plan; each log is written below a folder, read, and removed."""
    folder.mkdir(parents=True, exist_ok=True)
    return [row(folder / "ingest.mcap", *of) for of in plan(quick)]


def row(path, compression, content):
    """The Row of a log at path."""
    try:
        messages = large_logs.write(path, compression, content)
        raw = costs_of("-m", "benchmarking.decode_cost.process_cost", path)
        decode = costs_of(SCRIPTS / "decode.py", *arguments(path))
    finally:
        path.unlink(missing_ok=True)
    return Row(compression, content, messages, decode, raw)


def arguments(path):
    """Of scripts/decode.py, for a log of `repeated`; its outputs go beside it."""
    mocap = {"topics": ["/tf"], "map": large_logs.MAP, "max_gap_s": 0.05}
    options = {
        "log": str(path),
        "fingerprint": open_log.fingerprint(str(path)),
        "sensors": large_logs.sensors(),
        "mocap": mocap,
        "bodies": list(large_logs.BODIES),
        "from_s": None,
        "to_s": None,
    }
    names = {"mocap": "mocap.parquet", "frames": "frames.parquet", "audit": "log.json"}
    written = [word for k, name in names.items() for word in (f"--{k}", path.parent / name)]
    return *written, "--options", json.dumps(options)


def costs_of(*command):
    """The Cost that a script of this checkout says it had."""
    # A shell in between: a process inherits the peak memory of the one that starts it.
    words = ["/bin/sh", "-c", '"$@"; exit $?', "sh", sys.executable, *command]
    done = subprocess.run([str(w) for w in words], cwd=SCRIPTS, capture_output=True, text=True)
    found = process_cost.LINE.search(done.stderr)
    if done.returncode or not found:
        raise RuntimeError(f"{command[0]} did not read its log:\n{done.stderr}")
    wall, cpu, memory = found.groups()[1:]
    return process_cost.Cost(1, float(wall), float(cpu), int(memory))


def section(rows):
    """The Section on Rows."""
    return Section("Decoding", f"{WORDS}\n\n{ingest(rows)}", short_of(rows))


def ingest(rows):
    """The table of Rows."""
    head = ("chunks", "messages, GB", "messages", "decode, CPU s", "MB/s", "messages/s", "peak, MB")
    head += ("mcap's reader, CPU s", "MB/s", "messages/s", "peak, MB", "decode / reader")
    return table(head, [_cells(r) for r in rows])


def _cells(r):
    cells = [r.compression, digits(r.content / GB), str(r.messages)]
    for c in (r.decode, r.raw):
        speed = f"{r.content / 1e6 / c.cpu:.0f}", f"{r.messages / c.cpu:.0f}"
        cells += [digits(c.cpu), *speed, str(c.memory)]
    return [*cells, digits(r.ratio)]


def short_of(rows):
    """Sentences on what the Rows do not reach; small logs are held to no time, for most of that is
    the start of Python."""
    out = []
    for r in rows:
        name = f"decode of {digits(r.content / GB)} GB, chunks {r.compression}"
        if r.content >= GB and not r.ratio <= RATIO:
            out.append(f"{name}: {digits(r.ratio)} × mcap's own reader, goal {RATIO} ×")
        if not r.decode.memory <= MEMORY:
            out.append(f"{name}: {r.decode.memory} MB, goal {MEMORY} MB")
    return out
