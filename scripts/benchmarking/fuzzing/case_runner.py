"""Run random damaged and hostile inputs: each must give a result or a clear error message.

A case loads a config, or decodes and gates a log and reads its messages again, as crop does. It
ends as
  result      no fault was found;
  warning     a result, and messages on the faults;
  refused     an InputError with a clear message;
  broken      anything else: another exception, an incomplete output, an unclear message, a timeout.
"""

import contextlib
import hashlib
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

from benchmarking.fuzzing.crafted_cases import (
    run_hostile_chunks,
    run_hostile_definition,
    run_hostile_history,
    run_hostile_schema,
    run_hostile_template,
)
from benchmarking.fuzzing.log_cases import run_damaged_config, run_damaged_log, run_hostile_log
from calib.io.status import InputError

MAX_CASE_SECONDS = 20  # timeout; a case usually takes 50 ms
MAX_ERROR_CHARACTERS = 2000  # a longer error message is not clear
N_CASES_PER_TASK = 50
CASE_ENDS = ("result", "warning", "refused", "broken")


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


CASE_KINDS = {
    "damaged log": run_damaged_log,
    "hostile log": run_hostile_log,
    "config": run_damaged_config,
    "definition": run_hostile_definition,
    "chunks and index": run_hostile_chunks,
    "SQLite schema": run_hostile_schema,
    "template header": run_hostile_template,
    "history": run_hostile_history,
}


# --- running the cases


def run_fuzz_case(case_number: int, seed: int) -> FuzzOutcome:
    """Run one case; the same number and seed give the same case."""
    kind = list(CASE_KINDS)[case_number % len(CASE_KINDS)]
    rng, begin = np.random.default_rng([seed, case_number]), time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as surroundings:
        folder, neighbour = Path(surroundings) / "inside", Path(surroundings) / "outside"
        folder.mkdir()
        (neighbour / "deep").mkdir(parents=True)
        (neighbour / "deep" / "kept.txt").write_text("not to be changed")
        before = digest_surroundings(folder)
        end, message = _run_until_end(CASE_KINDS[kind], folder, rng)
        message = message.replace(str(folder), "")
        if digest_surroundings(folder) != before:
            end, message = "broken", f"changed files outside of its folder: {message}"
    return FuzzOutcome(
        kind=kind,
        case_number=case_number,
        end=end,
        message=message,
        seconds=time.perf_counter() - begin,
        peak_memory_mb=read_peak_memory(),
    )


def digest_surroundings(folder: Path) -> str:
    """Return a digest of the names, kinds and contents of all files beside a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.parent.rglob("*")):
        if not path.is_relative_to(folder):
            content = path.read_bytes() if path.is_file() else b""
            digest.update(f"{path} {path.lstat().st_mode} {len(content)} ".encode() + content)
    return digest.hexdigest()


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
