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
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import decode
import gate
from benchmarking.fuzzing import hostile_messages, random_configs, small_recordings
from benchmarking.fuzzing.byte_damage import DAMAGES
from calib.io import config, parquet_tables, pose_block, safe_yaml, stage_cli, table_schemas
from calib.io.logs import open_log
from calib.io.status import InputError
from calib.sensors import sensor_models
from calib.sensors.camera.images import image_messages
from calib.sensors.lidar.clouds import cloud_layout, cloud_messages
from calib.targets import target_shapes

MOST_SECONDS = 20  # of one case, which takes some 50 ms
LONGEST = 2000  # characters of a line that refuses
CHUNK = 50  # cases of one task
ENDS = ("result", "warning", "refused", "broken")
OUTPUTS = ("mocap", "frames", "audit")
GATE = {"pose_sigma": {"xyz_m": 2e-4, "rpy_deg": 0.02}, "max_gap_s": 0.05}


@dataclass(frozen=True)
class Outcome:
    """Of a case: its kind and number, how it ended, in which words, and its seconds; and the peak
    memory of the process up to then, MB."""

    kind: str
    number: int
    end: str
    words: str
    seconds: float
    memory: float


class Late(BaseException):
    """A case that takes too long: no `except Exception` may take it for a fault of the input."""


@contextlib.contextmanager
def at_most(seconds):
    """Raises Late instead of hanging."""

    def late(number, frame):
        raise Late(f"not done after {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


# --- cases: (folder, generator) -> words on what is wrong; they raise what they raise


def damaged_config(folder, rng):
    """A config that is loaded, and all that stages build of it."""
    for name, content in random_configs.files(rng).items():
        path = folder / "config" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    stated = safe_yaml.load(folder / "config/config.yaml")
    settings, rigs, bodies = config.load(stated, folder / "config")
    json.dumps([settings, rigs, bodies], sort_keys=True, allow_nan=False)
    for name in rigs:
        for block in rigs[name]["sensors"].values():
            if "T_robot_sensor" in block:
                pose_block.pose(block["T_robot_sensor"])
            if "camera_info" not in block:
                sensor_models.model(block)
    for body in bodies.values():
        pose_block.pose(body["T_body_target"])
        target_shapes.from_config(body)
    return ""


def damaged_log(folder, rng):
    """A good log in any container, some bytes of which are wrong or missing."""
    names = small_recordings.RECORDED[rng.integers(len(small_recordings.RECORDED))]
    container = list(small_recordings.CONTAINERS)[rng.integers(len(small_recordings.CONTAINERS))]
    path = small_recordings.write(container, folder / "log", small_recordings.rows(names))
    path.write_bytes(DAMAGES[rng.integers(len(DAMAGES))](bytearray(path.read_bytes()), rng))
    return taken_in(folder, str(path), small_recordings.options(names))


def hostile_log(folder, rng):
    """A log in any container whose messages say what no driver means."""
    names = small_recordings.RECORDED[rng.integers(len(small_recordings.RECORDED))]
    # The bag's writer knows no log time out of order, and fewer types.
    container = rng.choice([c for c in small_recordings.CONTAINERS if not c.startswith("bag")])
    path = small_recordings.write(container, folder / "log", hostile_messages.messages(names, rng))
    return taken_in(folder, str(path), small_recordings.options(names))


KINDS = {"damaged log": damaged_log, "hostile log": hostile_log, "config": damaged_config}


def taken_in(folder, log, options):
    """What decode, gate and crop's reading take from a log, in words where something is wrong."""
    out = {k: folder / "out" / k for k in OUTPUTS}
    arguments = [w for k, path in out.items() for w in (f"--{k}", str(path))]
    try:
        decode.main([*arguments, "--options", json.dumps(options | {"log": log})])
    finally:
        left = sorted(p.name for p in (folder / "out").glob("*"))
        assert left in ([], sorted(OUTPUTS)), f"files left: {left}"
    audit = stage_cli.read_json(out["audit"])
    _gate(folder, out)
    again = _again(log, parquet_tables.read(out["frames"], table_schemas.FRAMES)[0], options, audit)
    bad = [a["status"] for k in ("bodies", "sensors") for a in audit[k].values()]
    return "; ".join([*audit["faults"], *(s["reason"] for s in bad if not s["ok"]), *again])


def _gate(folder, out):
    target = folder / "out" / "placements"
    about = {"gate": config.defaults()["gate"], "body": "robot", "targets": {"board": "board"}}
    files = ["--mocap", str(out["mocap"]), "--audit", str(out["audit"]), "--output", str(target)]
    gate.main([*files, "--options", json.dumps(about | {"mocap": GATE})])


def _again(log, frames, options, audit):
    """Faults of messages that are read once more, as crop reads them."""
    opened, found = open_log.open_log(log), []
    for name, block in options["sensors"].items():
        if not audit["sensors"][name]["status"]["ok"]:
            continue
        read = _reader(block, audit["sensors"][name])
        for i in np.flatnonzero(frames["sensor"] == name):
            place = (int(frames[k][i]) for k in ("file", "log_t", "ordinal"))
            try:
                read(opened.message(block["topic"], *place))
            except InputError as error:
                found.append(str(error))
    return found


def _reader(block, heard):
    """How crop reads the messages of a sensor (of its audit) whose lens may not be known."""
    if block["kind"] == "camera":
        return image_messages.bgr
    layout = cloud_layout.Layout.from_dict(heard["layout"])
    return lambda message: cloud_messages.points(message, layout)


# --- and their ends


def outcome(number, seed):
    """The Outcome of the case of a number; the same for the same seed."""
    kind = list(KINDS)[number % len(KINDS)]
    rng, begin = np.random.default_rng([seed, number]), time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        end, words = _ended(KINDS[kind], Path(folder), rng)
        words = words.replace(folder, "")
    return Outcome(kind, number, end, words, time.perf_counter() - begin, peak())


def peak():
    """Peak memory of this process, MB; getrusage would tell a larger one of its parent."""
    told = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+) kB", told)[1]) / 1024


def _ended(case, folder, rng):
    """(end, words) of a case."""
    try:
        with at_most(MOST_SECONDS):
            words = case(folder, rng)
    except InputError as error:
        words = str(error)
        clear = words.strip() and len(words) <= LONGEST and "Traceback" not in words
        return ("refused", words) if clear else ("broken", f"no clear line: {words[:LONGEST]}")
    except (Exception, Late):
        return "broken", traceback.format_exc()
    return ("warning" if words else "result"), words


def outcomes(numbers, seed):
    """Outcomes of cases in this process, quietly."""
    logging.disable(logging.CRITICAL)
    try:
        return [outcome(number, seed) for number in numbers]
    finally:
        logging.disable(logging.NOTSET)


def everything(count, seed, cores):
    """Outcomes of so many cases, shared out among processes; the same for any number."""
    os.environ["OMP_NUM_THREADS"] = "1"
    spans = [range(i, min(i + CHUNK, count)) for i in range(0, count, CHUNK)]
    with ProcessPoolExecutor(cores, get_context("spawn")) as pool:
        return [o for part in pool.map(outcomes, spans, [seed] * len(spans)) for o in part]
