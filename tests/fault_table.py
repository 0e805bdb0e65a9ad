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
from calib.geometry import se3
from calib.io.logs import open_log
from calib.io.status import InputError

SENSORS = ("velodyne", "camera")
SHOWN = {"velodyne": "lidar", "camera": "camera"}
ONCE = ("",)
STAGES = (
    (decode, ONCE), (gate, ONCE), (guess, SENSORS), (crop, SENSORS), (extract, SENSORS),
    (associate, ONCE), (solve, ONCE), (judge, ONCE),
)  # fmt: skip
MOST = 1.3  # times the error of the clean log
CLEAN = "clean"
VERDICT = {"pass": "", "warn": ", warned", "fail": ", failed"}


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
        options["fingerprint"] = open_log.fingerprint(options["log"])
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
            off = se3.inverse(np.array(true[name]["T_robot_sensor"]["matrix"]))
            off = off @ np.array(pose["matrix"])
            variance = np.diag(found["sensors"][name]["covariance"])
            errors[name] = np.linalg.norm(off[:3, 3]), se3.angle(off[:3, :3])
            sigmas[name] = tuple(np.sqrt([variance[:3].sum(), variance[3:].sum()]))
    return Outcome(found["verdict"], wrecks.said(folder), errors, sigmas)


def stopped(folder):
    """Why nothing was made of a recording: the line on the terminal."""
    lines = (folder / "run.log").read_text().splitlines()
    return [next(line for line in lines if "logs/sim" in line).strip()]


def one(folder, keep):
    """Make, run and look at the recording of a working directory, which has the fault's name."""
    if not (keep and (folder / "run.log").exists()):
        run(wrecks.write(folder, wrecks.FAULTS.get(folder.name)))
    print(folder.name, file=sys.stderr, flush=True)
    return folder.name, outcome(folder)


def measured(work, names, keep=False, cores=2):
    """{name: Outcome} of the clean recording and of those faults; keep: use what an earlier run
    left."""
    wrecks.simulated("")
    found = dict([one(work / CLEAN, keep)])
    with ProcessPoolExecutor(cores, get_context("fork")) as pool:
        given = [work / name for name in names], [keep] * len(names)
        return found | dict(pool.map(one, *given))


# --- the page


def ratio(found, clean, sensor):
    """The error of a sensor's pose over the larger of the clean log's and its σ: the worse of
    position and rotation."""
    known = zip(found.errors[sensor], clean.errors[sensor], clean.sigmas[sensor], strict=True)
    return max(error / max(clean_error, sigma) for error, clean_error, sigma in known)


def sentence(fault, found, clean):
    """What is said of a fault, and not of the clean log; "" where nothing needs to be said."""
    if not fault.says:
        return ""
    known = set(clean.said)
    return next(s for s in found.said if fault.says in s and s not in known)


def comes_to(found, clean):
    """What a fault leaves of the calibration, in a few words."""
    if found.verdict == "stopped":
        return "stopped, named"
    lost = [SHOWN[s] for s in SENSORS if found.errors[s] is None]
    given = [s for s in SENSORS if found.errors[s] is not None]
    out = [f"fails: {', '.join(lost)}"] if lost else []
    if any(ratio(found, clean, s) > MOST for s in given):
        out.append(f"worse{VERDICT[found.verdict]}")
    return "; ".join(out) or "as clean"


def cell(found, clean, sensor):
    """`0.45 mm 0.010° (1.0)` of a sensor."""
    if found.errors[sensor] is None:
        return "none"
    m, rad = found.errors[sensor]
    return f"{1e3 * m:.2f} mm {np.degrees(rad):.4f}° ({ratio(found, clean, sensor):.2f})"


def row(name, found, clean):
    """One line of the table."""
    fault = wrecks.FAULTS[name]
    said = escaped(sentence(fault, found, clean)) or "–"
    errors = [cell(found, clean, s) for s in SENSORS]
    what = f"{fault.what}. {fault.note}" if fault.note else fault.what
    return f"| `{name}` | {what} | {said} | {' | '.join(errors)} | {comes_to(found, clean)} |"


def escaped(text):
    """Text as it may stand in a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


HEAD = (
    "| fixture | the fault | what is said | lidar | camera | comes to |\n|---|---|---|---|---|---|"
)
ABOUT = """# Faults of recordings, and what comes of them

Made by `make faults` from tests/wrecks.py and the files that it names, where each fixture makes its
fault in one recording with known truth: eight placements of a board and a cylinder before a lidar
of 16 beams and a camera, with the noise of a laboratory (ranges 10 mm, motion capture 0.15 mm and
0.02°, images 1.8 grey levels), drawn alike in all. Errors are those of T_robot_sensor against the
truth. The clean recording: lidar {velodyne}, camera {camera}.

*What is said* stands in log.json, in the report's audit and funnel, or in verdict.json; nothing is
said where the recording is read as it is. In brackets, the error over that of the clean recording,
or over the clean recording's σ where that is larger: an error below σ is the luck of one draw, and
a multiple of it means nothing. The worse of position and rotation counts.

| comes to | |
|---|---|
| as clean | at most {most} times that |
| fails: … | no pose is given, and why is said; the other sensor is as clean |
| worse, failed; worse, warned; worse | a pose beyond that, and a verdict of that kind, or pass |
| stopped, named | nothing is calibrated, and one line says why |
"""


def page(found):
    """docs/faults.md of {name: Outcome}."""
    clean = found[CLEAN]
    shown = {
        s: f"{1e3 * clean.errors[s][0]:.2f} mm {np.degrees(clean.errors[s][1]):.4f}° "
        f"(σ {1e3 * clean.sigmas[s][0]:.2f} mm {np.degrees(clean.sigmas[s][1]):.4f}°)"
        for s in SENSORS
    }
    lines = [ABOUT.format(**shown, most=MOST)]
    for group, faults in wrecks.GROUPS.items():
        rows = [row(name, found[name], clean) for name in faults]
        lines += [f"## {group}\n", HEAD, *rows, ""]
    return "\n".join(lines)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path, metavar="WORK", help="an own folder")
    parser.add_argument("--docs", type=Path, default=runs.ROOT / "docs", help="where it is written")
    parser.add_argument("--keep", action="store_true", help="what an earlier run left in WORK")
    parser.add_argument("--cores", type=int, default=2)
    args = parser.parse_args(argv)
    found = measured(args.work.resolve(), list(wrecks.FAULTS), args.keep, args.cores)
    (args.docs / "faults.md").write_text(page(found))


if __name__ == "__main__":
    main()
