"""Run random damaged and hostile inputs: each must give a result or a clear error message.

A case loads a config, or decodes and gates a log and reads its messages again, as crop does. It
ends as
  result      no fault was found;
  warning     a result, and messages on the faults;
  refused     an InputError with a clear message;
  broken      anything else: another exception, an incomplete output, an unclear message, a timeout.
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

MAX_CASE_SECONDS = 20  # timeout; a case usually takes 50 ms
MAX_ERROR_CHARACTERS = 2000  # a longer error message is not clear
N_CASES_PER_TASK = 50
CASE_ENDS = ("result", "warning", "refused", "broken")
DECODE_OUTPUTS = ("mocap", "frames", "audit")
GATE_MOCAP = {
    "pose_sigma": {"xyz_m": 2e-4, "rpy_deg": 0.02},
    "pose_bias_sigma": {"xyz_m": 1e-4, "rpy_deg": 0.01},
    "max_gap_s": 0.05,
    "use_measured_noise": True,
}


@dataclass(frozen=True)
class FuzzOutcome:
    """How one case ended.

    end: one of CASE_ENDS; message: warnings, error or traceback; peak_memory_mb: of the process so
    far.
    """

    kind: str
    case_number: int
    end: str
    message: str
    seconds: float
    peak_memory_mb: float


class CaseTimeoutError(BaseException):
    """A case takes too long. Not an Exception, so that no `except Exception` catches it."""


@contextlib.contextmanager
def limit_time(max_seconds: int) -> Iterator[None]:
    """Raise CaseTimeoutError in the block after max_seconds."""

    def raise_timeout(number: int, frame: Any) -> None:
        raise CaseTimeoutError(f"not done after {max_seconds} s")

    before = signal.signal(signal.SIGALRM, raise_timeout)
    signal.alarm(max_seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


# --- cases: (folder, generator) -> warnings, "" if there are none; errors are not caught here


def run_damaged_config(folder: Path, rng: np.random.Generator) -> str:
    """Load a damaged config, and make all that the stages make from it."""
    for name, content in draw_config_files(rng).items():
        path = folder / "config" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    stated = load_yaml(folder / "config/config.yaml")
    settings, rigs, targets = load_config(stated, folder / "config")
    json.dumps([settings, rigs, targets], sort_keys=True, allow_nan=False)
    for name in rigs:
        for block in rigs[name]["sensors"].values():
            if "T_robot_sensor" in block:
                pose_from_config(block["T_robot_sensor"])
            if "camera_info" not in block:
                sensor_model_from_config(block)
    for target in targets.values():
        pose_from_config(target["T_body_target"])
        target_from_config(target)
    return ""


def run_damaged_log(folder: Path, rng: np.random.Generator) -> str:
    """Decode a good log, in a random container, with damaged bytes."""
    names = SENSOR_GROUPS[rng.integers(len(SENSOR_GROUPS))]
    container = list(FUZZ_CONTAINERS)[rng.integers(len(FUZZ_CONTAINERS))]
    path = write_fuzz_log(container, folder / "log", make_fuzz_messages(names))
    path.write_bytes(
        BYTE_DAMAGES[rng.integers(len(BYTE_DAMAGES))](bytearray(path.read_bytes()), rng)
    )
    return decode_and_reread(folder, str(path), fuzz_decode_options(names))


def run_hostile_log(folder: Path, rng: np.random.Generator) -> str:
    """Decode a log, in a random container, with meaningless values in its messages."""
    names = SENSOR_GROUPS[rng.integers(len(SENSOR_GROUPS))]
    # The writer of bags accepts only ordered log times, and fewer types.
    container = rng.choice([c for c in FUZZ_CONTAINERS if not c.startswith("bag")])
    path = write_fuzz_log(container, folder / "log", make_hostile_messages(names, rng))
    return decode_and_reread(folder, str(path), fuzz_decode_options(names))


CASE_KINDS = {
    "damaged log": run_damaged_log,
    "hostile log": run_hostile_log,
    "config": run_damaged_config,
}


def decode_and_reread(folder: Path, log: str, options: dict[str, Any]) -> str:
    """Decode and gate a log and read its messages again; return the warnings."""
    out = {k: folder / "out" / k for k in DECODE_OUTPUTS}
    arguments = [w for k, path in out.items() for w in (f"--{k}", str(path))]
    try:
        decode.main([*arguments, "--options", json.dumps(options | {"log": log})])
    finally:
        written = sorted(p.name for p in (folder / "out").glob("*"))
        assert written in ([], sorted(DECODE_OUTPUTS)), f"files left: {written}"
    audit = read_json(out["audit"])
    _run_gate(folder, out)
    reread_faults = _reread_messages(
        log, read_table(out["frames"], FRAMES_SCHEMA)[0], options, audit
    )
    statuses = [a["status"] for k in ("bodies", "sensors") for a in audit[k].values()]
    reasons = [s["reason"] for s in statuses if not s["ok"]]
    return "; ".join([*audit["faults"], *reasons, *reread_faults])


def _run_gate(folder: Path, output_paths: dict[str, Path]) -> None:
    options = {
        "mocap": GATE_MOCAP,
        "gate": default_config_blocks()["gate"],
        "body": "robot",
        "targets": {"board": "board"},
    }
    files = {
        "--mocap": output_paths["mocap"],
        "--audit": output_paths["audit"],
        "--output": folder / "out" / "placements",
    }
    arguments = [word for key, path in files.items() for word in (key, str(path))]
    gate.main([*arguments, "--options", json.dumps(options)])


def _reread_messages(
    log: str, frames: dict[str, np.ndarray], options: dict[str, Any], audit: dict[str, Any]
) -> list[str]:
    """Read the messages again, as crop does; return the errors."""
    opened, errors = open_log(log), []
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
                errors.append(str(error))
    return errors


def _message_reader(block: dict[str, Any], sensor_audit: dict[str, Any]) -> Callable[[Any], Any]:
    """Return the function with which crop reads the messages of a sensor."""
    if block["kind"] == "camera":
        return read_bgr
    layout = CloudLayout.from_dict(sensor_audit["layout"])
    return lambda message: cloud_messages.read_points(message, layout)


# --- running the cases


def run_fuzz_case(case_number: int, seed: int) -> FuzzOutcome:
    """Run one case; the same number and seed give the same case."""
    kind = list(CASE_KINDS)[case_number % len(CASE_KINDS)]
    rng, begin = np.random.default_rng([seed, case_number]), time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        end, message = _run_until_end(CASE_KINDS[kind], Path(folder), rng)
        message = message.replace(folder, "")
    return FuzzOutcome(
        kind=kind,
        case_number=case_number,
        end=end,
        message=message,
        seconds=time.perf_counter() - begin,
        peak_memory_mb=read_peak_memory(),
    )


def read_peak_memory() -> float:
    """Return the peak memory of this process, MB; getrusage may return that of its parent."""
    status = Path("/proc/self/status").read_text()
    match = re.search(r"VmHWM:\s+(\d+) kB", status)
    assert match, "no VmHWM in /proc/self/status"
    return int(match[1]) / 1024


def _run_until_end(
    run_case: Callable[[Path, np.random.Generator], str],
    folder: Path,
    rng: np.random.Generator,
) -> tuple[str, str]:
    """Run a case; return its end and message."""
    try:
        with limit_time(MAX_CASE_SECONDS):
            warnings = run_case(folder, rng)
    except InputError as error:
        return _classify_input_error(str(error))
    except (Exception, CaseTimeoutError):
        return "broken", traceback.format_exc()
    return ("warning" if warnings else "result"), warnings


def _classify_input_error(message: str) -> tuple[str, str]:
    """Return end and message of a case with an InputError: broken if its message is not clear."""
    if message.strip() and len(message) <= MAX_ERROR_CHARACTERS and "Traceback" not in message:
        return "refused", message
    return "broken", f"no clear error message: {message[:MAX_ERROR_CHARACTERS]}"


def run_fuzz_batch(case_numbers: range, seed: int) -> list[FuzzOutcome]:
    """Run cases in this process, without log output."""
    logging.disable(logging.CRITICAL)
    try:
        return [run_fuzz_case(number, seed) for number in case_numbers]
    finally:
        logging.disable(logging.NOTSET)


def run_fuzz_campaign(n_cases: int, seed: int, n_cores: int) -> list[FuzzOutcome]:
    """Run n_cases in n_cores processes; the result does not depend on n_cores."""
    os.environ["OMP_NUM_THREADS"] = "1"
    spans = [
        range(i, min(i + N_CASES_PER_TASK, n_cases)) for i in range(0, n_cases, N_CASES_PER_TASK)
    ]
    with ProcessPoolExecutor(n_cores, get_context("spawn")) as pool:
        return [o for part in pool.map(run_fuzz_batch, spans, [seed] * len(spans)) for o in part]
