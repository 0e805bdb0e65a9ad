"""Damaged and hostile input, drawn from a seed: whatever it is, there is a result or a clear line.

A case is a config that is loaded, or a log that is decoded, gated and read again as crop reads it.
It ends as
  result      nothing was found to be wrong;
  warning     a result, and words on what is wrong;
  refused     an InputError in one line, or several where it lists reasons;
  broken      anything else: another exception, a file half written, words that need no reading.
"""

import contextlib
import json
import logging
import os
import re
import signal
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import decode
import gate
from benchmarking.fuzzing.byte_damage import BYTE_DAMAGES
from benchmarking.fuzzing.hostile_messages import make_hostile_messages
from benchmarking.fuzzing.random_configs import draw_config_files
from benchmarking.fuzzing.small_recordings import (
    FUZZ_CONTAINERS,
    SENSOR_GROUPS,
    fuzz_decode_options,
    make_fuzz_messages,
    write_fuzz_log,
)
from calib.io.config import default_config_blocks, load_config
from calib.io.logs.open_log import open_log
from calib.io.parquet_tables import read_table
from calib.io.pose_block import pose_from_config
from calib.io.safe_yaml import load_yaml
from calib.io.stage_cli import read_json
from calib.io.status import InputError
from calib.io.table_schemas import FRAMES_SCHEMA
from calib.sensors.camera.images.image_messages import read_bgr
from calib.sensors.lidar.clouds import cloud_messages
from calib.sensors.lidar.clouds.cloud_layout import CloudLayout
from calib.sensors.sensor_models import sensor_model_from_config
from calib.targets.target_shapes import target_from_config

MAX_CASE_SECONDS = 20  # of one case, which takes some 50 ms
MAX_ERROR_CHARACTERS = 2000  # characters of a line that refuses
N_CASES_PER_TASK = 50  # cases of one task
CASE_ENDS = ("result", "warning", "refused", "broken")
DECODE_OUTPUTS = ("mocap", "frames", "audit")
GATE_MOCAP = {"pose_sigma": {"xyz_m": 2e-4, "rpy_deg": 0.02}, "max_gap_s": 0.05}


@dataclass(frozen=True)
class FuzzOutcome:
    """Of a case: its kind and number, how it ended, in which words, and its seconds; and the peak
    memory of the process up to then, MB."""

    kind: str
    case_number: int
    end: str
    message: str
    seconds: float
    peak_memory_mb: float


class CaseTimeoutError(BaseException):
    """A case that takes too long: no `except Exception` may take it for a fault of the input."""


@contextlib.contextmanager
def limit_time(max_seconds: int) -> Iterator[None]:
    """Raises Late instead of hanging."""

    def late(number: int, frame: Any) -> None:
        raise CaseTimeoutError(f"not done after {max_seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(max_seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


# --- cases: (folder, generator) -> words on what is wrong; they raise what they raise


def run_damaged_config(folder: Path, rng: np.random.Generator) -> str:
    """A config that is loaded, and all that stages build of it."""
    for name, content in draw_config_files(rng).items():
        path = folder / "config" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    stated = load_yaml(folder / "config/config.yaml")
    settings, rigs, bodies = load_config(stated, folder / "config")
    json.dumps([settings, rigs, bodies], sort_keys=True, allow_nan=False)
    for name in rigs:
        for block in rigs[name]["sensors"].values():
            if "T_robot_sensor" in block:
                pose_from_config(block["T_robot_sensor"])
            if "camera_info" not in block:
                sensor_model_from_config(block)
    for body in bodies.values():
        pose_from_config(body["T_body_target"])
        target_from_config(body)
    return ""


def run_damaged_log(folder: Path, rng: np.random.Generator) -> str:
    """A good log in any container, some bytes of which are wrong or missing."""
    names = SENSOR_GROUPS[rng.integers(len(SENSOR_GROUPS))]
    container = list(FUZZ_CONTAINERS)[rng.integers(len(FUZZ_CONTAINERS))]
    path = write_fuzz_log(container, folder / "log", make_fuzz_messages(names))
    path.write_bytes(
        BYTE_DAMAGES[rng.integers(len(BYTE_DAMAGES))](bytearray(path.read_bytes()), rng)
    )
    return decode_and_reread(folder, str(path), fuzz_decode_options(names))


def run_hostile_log(folder: Path, rng: np.random.Generator) -> str:
    """A log in any container whose messages say what no driver means."""
    names = SENSOR_GROUPS[rng.integers(len(SENSOR_GROUPS))]
    # The bag's writer knows no log time out of order, and fewer types.
    container = rng.choice([c for c in FUZZ_CONTAINERS if not c.startswith("bag")])
    path = write_fuzz_log(container, folder / "log", make_hostile_messages(names, rng))
    return decode_and_reread(folder, str(path), fuzz_decode_options(names))


CASE_KINDS = {
    "damaged log": run_damaged_log,
    "hostile log": run_hostile_log,
    "config": run_damaged_config,
}


def decode_and_reread(folder: Path, log: str, options: dict[str, Any]) -> str:
    """What decode, gate and crop's reading take from a log, in words where something is wrong."""
    out = {k: folder / "out" / k for k in DECODE_OUTPUTS}
    arguments = [w for k, path in out.items() for w in (f"--{k}", str(path))]
    try:
        decode.main([*arguments, "--options", json.dumps(options | {"log": log})])
    finally:
        left = sorted(p.name for p in (folder / "out").glob("*"))
        assert left in ([], sorted(DECODE_OUTPUTS)), f"files left: {left}"
    audit = read_json(out["audit"])
    _run_gate(folder, out)
    again = _reread_messages(log, read_table(out["frames"], FRAMES_SCHEMA)[0], options, audit)
    bad = [a["status"] for k in ("bodies", "sensors") for a in audit[k].values()]
    return "; ".join([*audit["faults"], *(s["reason"] for s in bad if not s["ok"]), *again])


def _run_gate(folder: Path, output_paths: dict[str, Path]) -> None:
    target = folder / "out" / "placements"
    about = {
        "gate": default_config_blocks()["gate"],
        "body": "robot",
        "targets": {"board": "board"},
    }
    files = [
        "--mocap",
        str(output_paths["mocap"]),
        "--audit",
        str(output_paths["audit"]),
        "--output",
        str(target),
    ]
    gate.main([*files, "--options", json.dumps(about | {"mocap": GATE_MOCAP})])


def _reread_messages(
    log: str, frames: dict[str, np.ndarray], options: dict[str, Any], audit: dict[str, Any]
) -> list[str]:
    """Faults of messages that are read once more, as crop reads them."""
    opened, found = open_log(log), []
    for name, block in options["sensors"].items():
        if not audit["sensors"][name]["status"]["ok"]:
            continue
        read = _message_reader(block, audit["sensors"][name])
        for i in np.flatnonzero(frames["sensor"] == name):
            file_index, log_time_ns, index_at_log_time = (
                int(frames[k][i]) for k in ("file_index", "log_time_ns", "index_at_log_time")
            )
            try:
                read(
                    opened.read_message_content(
                        block["topic"], file_index, log_time_ns, index_at_log_time
                    )
                )
            except InputError as error:
                found.append(str(error))
    return found


def _message_reader(block: dict[str, Any], sensor_audit: dict[str, Any]) -> Callable[[Any], Any]:
    """How crop reads the messages of a sensor (of its audit) whose lens may not be known."""
    if block["kind"] == "camera":
        return read_bgr
    layout = CloudLayout.from_dict(sensor_audit["layout"])
    return lambda message: cloud_messages.read_points(message, layout)


# --- and their ends


def run_fuzz_case(case_number: int, seed: int) -> FuzzOutcome:
    """The Outcome of the case of a number; the same for the same seed."""
    kind = list(CASE_KINDS)[case_number % len(CASE_KINDS)]
    rng, begin = np.random.default_rng([seed, case_number]), time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        end, words = _run_until_end(CASE_KINDS[kind], Path(folder), rng)
        words = words.replace(folder, "")
    return FuzzOutcome(
        kind, case_number, end, words, time.perf_counter() - begin, read_peak_memory()
    )


def read_peak_memory() -> float:
    """Peak memory of this process, MB; getrusage would tell a larger one of its parent."""
    told = Path("/proc/self/status").read_text()
    match = re.search(r"VmHWM:\s+(\d+) kB", told)
    assert match, "no VmHWM in /proc/self/status"
    return int(match[1]) / 1024


def _run_until_end(
    run_case: Callable[[Path, np.random.Generator], str],
    folder: Path,
    rng: np.random.Generator,
) -> tuple[str, str]:
    """(end, words) of a case."""
    try:
        with limit_time(MAX_CASE_SECONDS):
            words = run_case(folder, rng)
    except InputError as error:
        words = str(error)
        clear = words.strip() and len(words) <= MAX_ERROR_CHARACTERS and "Traceback" not in words
        return (
            ("refused", words)
            if clear
            else ("broken", f"no clear line: {words[:MAX_ERROR_CHARACTERS]}")
        )
    except (Exception, CaseTimeoutError):
        return "broken", traceback.format_exc()
    return ("warning" if words else "result"), words


def run_fuzz_batch(case_numbers: range, seed: int) -> list[FuzzOutcome]:
    """Outcomes of cases in this process, quietly."""
    logging.disable(logging.CRITICAL)
    try:
        return [run_fuzz_case(number, seed) for number in case_numbers]
    finally:
        logging.disable(logging.NOTSET)


def run_fuzz_campaign(n_cases: int, seed: int, n_cores: int) -> list[FuzzOutcome]:
    """Outcomes of so many cases, shared out among processes; the same for any number."""
    os.environ["OMP_NUM_THREADS"] = "1"
    spans = [
        range(i, min(i + N_CASES_PER_TASK, n_cases)) for i in range(0, n_cases, N_CASES_PER_TASK)
    ]
    with ProcessPoolExecutor(n_cores, get_context("spawn")) as pool:
        return [o for part in pool.map(run_fuzz_batch, spans, [seed] * len(spans)) for o in part]
