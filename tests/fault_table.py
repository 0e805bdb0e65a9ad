"""Measure every fault of wrecks.py through the pipeline: the table of docs/faults.md.

Writes a recording with each fault below WORK, calibrates it with the pipeline in a working
directory of its own, and compares the poses with truth.json and with those of the clean recording.
"""

import argparse
import json
import os
import shutil
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np

import associate
import crop
import decode
import extract
import gate
import guess
import judge
import runs
import solve
import wrecks
from calib import geometry, logs
from calib.status import InputError

SENSORS = ("velodyne", "camera")
ONCE = ("",)
STAGES = (
    (decode, ONCE), (gate, ONCE), (guess, SENSORS), (crop, SENSORS), (extract, SENSORS),
    (associate, ONCE), (solve, ONCE), (judge, ONCE),
)  # fmt: skip
MOST = 1.3  # times the error of the clean log
CLEAN = "clean"


class Outcome(NamedTuple):
    """What came of one recording: verdict, sentences, and errors, σ by sensor: (m, rad), None where
    there is no pose."""

    verdict: str
    said: list
    errors: dict
    sigmas: dict


def commands(folder):
    """{(stage, sensor or ""): arguments of its script}, as Snakemake gives them; of a recording
    whose config is that of the clean one, but for the fingerprint of the log, without it."""
    clean = folder.parent / CLEAN
    same = all(
        path.read_bytes() == (clean / path.relative_to(folder)).read_bytes()
        for path in sorted(folder.glob("config/**/*.yaml"))
    )
    known = _of_snakemake(clean if same else folder)
    return {k: _fitted(words) for k, words in known.items()}


@cache
def _of_snakemake(folder):
    return runs.commands(folder)


def _fitted(words):
    """Arguments with the fingerprint of the log below the working directory."""
    options = json.loads(words[-1])
    if "fingerprint" in options:
        options["fingerprint"] = logs.fingerprint(options["log"])
    return [*words[:-1], json.dumps(options)]


def run(folder):
    """Take a working directory through all stages, in this process; what stops it goes into
    run.log."""
    os.chdir(folder)
    shutil.rmtree(wrecks.RESULTS, ignore_errors=True)
    for name in SENSORS:
        Path(wrecks.RESULTS, "sim", name).mkdir(parents=True)
    try:
        given = commands(folder)
        for module, sensors in STAGES:
            for sensor in sensors:
                module.main(given[module.__name__, sensor])
        said = ""
    except (InputError, AssertionError) as error:
        said = str(error)
    Path("run.log").write_text(said)


def outcome(folder):
    """The Outcome of a working directory that was run."""
    path = folder / wrecks.RESULTS / "calibration.json"
    if not path.exists():
        return Outcome("stopped", stopped(folder), dict.fromkeys(SENSORS), dict.fromkeys(SENSORS))
    found = json.loads(path.read_text())
    true = json.loads((folder / "truth.json").read_text())["sensors"]
    errors, sigmas = {}, {}
    for name in SENSORS:
        pose = found["sensors"][name]["T_robot_sensor"]
        errors[name] = sigmas[name] = None
        if pose:
            off = geometry.inverse(np.array(true[name]["T_robot_sensor"]["matrix"]))
            off = off @ np.array(pose["matrix"])
            variance = np.diag(found["sensors"][name]["covariance"])
            errors[name] = np.linalg.norm(off[:3, 3]), geometry.angle(off[:3, :3])
            sigmas[name] = tuple(np.sqrt([variance[:3].sum(), variance[3:].sum()]))
    return Outcome(found["verdict"], wrecks.said(folder), errors, sigmas)


def stopped(folder):
    """Why nothing was made of a recording: the line on the terminal."""
    lines = (folder / "run.log").read_text().splitlines()
    return [next(line for line in lines if "logs/sim" in line).strip()]


def one(folder):
    """Make, run and look at the recording of a working directory, which has the fault's name."""
    run(wrecks.write(folder, wrecks.FAULTS.get(folder.name)))
    print(folder.name, file=sys.stderr, flush=True)
    return folder.name, outcome(folder)


def measured(work, names):
    """{name: Outcome} of the clean recording and of those faults."""
    wrecks.simulated("")
    found = dict([one(work / CLEAN)])
    with ProcessPoolExecutor(2, get_context("fork")) as pool:
        return found | dict(pool.map(one, [work / name for name in names]))


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path, metavar="WORK", help="an own folder")
    parser.add_argument("only", nargs="*", choices=[[], *wrecks.FAULTS])
    args = parser.parse_args(argv)
    measured(args.work.resolve(), args.only or list(wrecks.FAULTS))


if __name__ == "__main__":
    main()
