"""A job whose memory runs out ends in one line that names its file, the limit and what to do."""

import json
import logging
import re
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from calib.io import stage_cli
from calib.io.logs.message_types import MessageTypes
from calib.io.stage_cli import is_out_of_memory, run_stage
from calib.io.status import InputError

REPO = Path(__file__).parents[3]


def raise_from_memory_error():
    try:
        np.zeros(1 << 62, np.uint8)
    except MemoryError as error:
        raise InputError("a message that cannot be read") from error


def raised(function):
    try:
        function()
    except Exception as error:
        return error
    raise AssertionError("nothing was raised")


@pytest.mark.parametrize(
    "function",
    [
        lambda: bytearray(1 << 62),
        lambda: np.zeros(1 << 62, np.uint8),
        lambda: pa.allocate_buffer(1 << 62),
        raise_from_memory_error,
    ],
    ids=["bytes", "numpy", "arrow", "cause of another error"],
)
def test_errors_of_every_library_that_finds_no_memory_are_known(function):
    assert is_out_of_memory(raised(function))
    assert not is_out_of_memory(InputError("memory"))


@pytest.mark.parametrize(
    "words, names",
    [
        (["--options", json.dumps({"log": "logs/a.mcap"})], "logs/a.mcap"),
        (["--options", json.dumps({"log": ["b.db3", "c.db3"]})], "b.db3, c.db3"),
        (["--mocap", "results/x/mocap.parquet", "--options", "{}"], "results/x/mocap.parquet"),
    ],
    ids=["log", "log of two files", "no log"],
)
def test_the_line_names_the_files_the_limit_and_the_key(words, names, monkeypatch, caplog):
    monkeypatch.setattr(sys, "argv", ["scripts/crop.py", *words])
    monkeypatch.setattr(resource, "getrlimit", lambda which: (2000 << 20, resource.RLIM_INFINITY))
    with caplog.at_level(logging.ERROR), pytest.raises(SystemExit):
        run_stage(lambda: bytearray(1 << 62))
    assert caplog.messages[-1] == (
        f"error: {names}: crop needs more memory than its limit, 2000 MB of address space. If the "
        "files are yours and sound, raise it: snakemake --set-resources crop:mem_mb=4000."
    )


def test_memory_that_runs_out_within_a_message_does_not_count_as_a_damaged_message(monkeypatch):
    codec = MessageTypes("a.mcap").make_codec("std_msgs/msg/String", "cdr")

    def run_out(data, name):
        raise MemoryError

    monkeypatch.setitem(codec.__dict__, "_deserialize", run_out)
    with pytest.raises(MemoryError):
        codec.decode(b"\0\1\0\0\1\0\0\0\0")


def test_a_job_under_a_limit_of_address_space_ends_in_one_line():
    code = "from calib.io.stage_cli import run_stage; run_stage(lambda: bytearray(1 << 31))"
    done = subprocess.run(
        ["bash", "-c", 'ulimit -v 1500000; exec "$0" "$@"', sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={"PYTHONPATH": str(REPO / "scripts"), "OMP_NUM_THREADS": "1"},
    )
    (line,) = done.stderr.splitlines()
    assert done.returncode == 1 and "1464 MB of address space" in line


def test_every_rule_that_runs_a_stage_limits_its_memory():
    text = (REPO / "Snakefile").read_text()
    for rule in re.split(r"\nrule ", text)[1:]:
        if "python {input.code" in rule:
            assert '"limit_memory {resources.mem_mb};"' in rule
            assert "mem_mb=MAX_JOB_MEMORY_MB" in rule
    assert stage_cli.RULE_BY_STAGE.keys() <= {p.stem for p in (REPO / "scripts").glob("*.py")}
