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
import solve
from benchmarking.fault_matrix.matrix_page import split_page
from benchmarking.page.markdown import render_markdown
from calib.geometry.se3 import invert_pose, rotation_angle
from calib.io.logs.open_log import fingerprint_log
from calib.io.status import InputError
from helpers import small_run
from helpers.fault_catalog.all_faults import (
    FAULT_CASES,
    FAULT_GROUPS,
    RESULTS_FOLDER,
    list_run_messages,
    simulate_clean_rows,
    write_fault_run,
)
from helpers.small_run import list_job_commands

TABLE_SENSORS = ("velodyne", "camera")
SENSOR_TITLES = {"velodyne": "lidar", "camera": "camera"}
NO_SENSOR = ("",)
STAGE_SENSORS = (
    (decode, NO_SENSOR),
    (gate, NO_SENSOR),
    (guess, TABLE_SENSORS),
    (crop, TABLE_SENSORS),
    (extract, TABLE_SENSORS),
    (associate, NO_SENSOR),
    (solve, NO_SENSOR),
    (judge, NO_SENSOR),
)
MAX_ERROR_RATIO = 1.3  # times the error of the clean log
CLEAN_NAME = "clean"
VERDICT_SUFFIX = {"pass": "", "warn": ", warned", "fail": ", failed"}


class FaultOutcome(NamedTuple):
    """What came of one recording: verdict, sentences, and errors, σ by sensor: (m, rad), None where
    there is no pose."""

    verdict: str
    messages: list
    errors: dict
    sigmas: dict


def list_stage_arguments(folder):
    """{(stage, sensor or ""): arguments of its script}, as Snakemake gives them; of a recording
    whose config is that of the clean one, but for the fingerprint of the log, without it."""
    clean = folder.parent / CLEAN_NAME
    same = all(
        path.read_bytes() == (clean / path.relative_to(folder)).read_bytes()
        for path in sorted(folder.glob("config/**/*.yaml"))
    )
    known = _snakemake_arguments(clean if same else folder)
    return {k: _with_log_fingerprint(words) for k, words in known.items()}


@cache
def _snakemake_arguments(folder):
    return list_job_commands(folder)


def _with_log_fingerprint(arguments):
    """Arguments with the fingerprint of the log below the working directory."""
    options = json.loads(arguments[-1])
    if "fingerprint" in options:
        options["fingerprint"] = fingerprint_log(options["log"])
    return [*arguments[:-1], json.dumps(options)]


def run_fault_case(folder):
    """Take a working directory through all stages, in this process; what stops it goes into
    run.log."""
    os.chdir(folder)
    shutil.rmtree(RESULTS_FOLDER, ignore_errors=True)
    for name in TABLE_SENSORS:
        Path(RESULTS_FOLDER, "sim", name).mkdir(parents=True)
    try:
        given = list_stage_arguments(folder)
        for module, sensors in STAGE_SENSORS:
            for sensor in sensors:
                module.main(given[module.__name__, sensor])
        said = ""
    except (InputError, AssertionError) as error:
        said = str(error)
    Path("run.log").write_text(said)


def read_fault_outcome(folder):
    """The Outcome of a working directory that was run."""
    path = folder / RESULTS_FOLDER / "calibration.json"
    if not path.exists():
        return FaultOutcome(
            "stopped",
            read_stop_message(folder),
            dict.fromkeys(TABLE_SENSORS),
            dict.fromkeys(TABLE_SENSORS),
        )
    found = json.loads(path.read_text())
    true = json.loads((folder / "truth.json").read_text())["sensors"]
    errors, sigmas = {}, {}
    for name in TABLE_SENSORS:
        pose = found["sensors"][name]["T_robot_sensor"]
        errors[name] = sigmas[name] = None
        if pose:
            off = invert_pose(np.array(true[name]["T_robot_sensor"]["matrix"]))
            off = off @ np.array(pose["matrix"])
            variance = np.diag(found["sensors"][name]["covariance"])
            errors[name] = np.linalg.norm(off[:3, 3]), rotation_angle(off[:3, :3])
            sigmas[name] = tuple(np.sqrt([variance[:3].sum(), variance[3:].sum()]))
    return FaultOutcome(found["verdict"], list_run_messages(folder), errors, sigmas)


def read_stop_message(folder):
    """Why nothing was made of a recording: the line on the terminal."""
    lines = (folder / "run.log").read_text().splitlines()
    return [next(line for line in lines if "logs/sim" in line).strip()]


def measure_fault(folder, has_kept_run):
    """Make, run and look at the recording of a working directory, which has the fault's name."""
    if not (has_kept_run and (folder / "run.log").exists()):
        run_fault_case(write_fault_run(folder, FAULT_CASES.get(folder.name)))
    print(folder.name, file=sys.stderr, flush=True)
    return folder.name, read_fault_outcome(folder)


def measure_all_faults(work, fault_names, has_kept_run=False, cores=2):
    """{name: Outcome} of the clean recording and of those faults; has_kept_run: use what an earlier
    run left."""
    simulate_clean_rows("")
    found = dict([measure_fault(work / CLEAN_NAME, has_kept_run)])
    with ProcessPoolExecutor(cores, get_context("fork")) as pool:
        given = [work / name for name in fault_names], [has_kept_run] * len(fault_names)
        return found | dict(pool.map(measure_fault, *given))


# --- the page


def compute_error_ratio(outcome, clean_outcome, sensor):
    """The error of a sensor's pose over the larger of the clean log's and its σ: the worse of
    position and rotation."""
    known = zip(
        outcome.errors[sensor],
        clean_outcome.errors[sensor],
        clean_outcome.sigmas[sensor],
        strict=True,
    )
    return max(error / max(clean_error, sigma) for error, clean_error, sigma in known)


def find_fault_message(fault, outcome, clean_outcome):
    """What is said of a fault, and not of the clean log; "" where nothing needs to be said."""
    if not fault.expected_text:
        return ""
    known = set(clean_outcome.messages)
    return next(s for s in outcome.messages if fault.expected_text in s and s not in known)


def describe_consequence(outcome, clean_outcome):
    """What a fault leaves of the calibration, in a few words."""
    if outcome.verdict == "stopped":
        return "stopped, named"
    lost = [SENSOR_TITLES[s] for s in TABLE_SENSORS if outcome.errors[s] is None]
    given = [s for s in TABLE_SENSORS if outcome.errors[s] is not None]
    out = [f"fails: {', '.join(lost)}"] if lost else []
    if any(compute_error_ratio(outcome, clean_outcome, s) > MAX_ERROR_RATIO for s in given):
        out.append(f"worse{VERDICT_SUFFIX[outcome.verdict]}")
    return "; ".join(out) or "as clean"


def format_error_cell(outcome, clean_outcome, sensor):
    """`0.45 mm 0.010° (1.0)` of a sensor."""
    if outcome.errors[sensor] is None:
        return "none"
    m, rad = outcome.errors[sensor]
    ratio = compute_error_ratio(outcome, clean_outcome, sensor)
    return f"{1e3 * m:.2f} mm {np.degrees(rad):.4f}° ({ratio:.2f})"


def format_fault_row(fault_name, outcome, clean_outcome):
    """One line of the table."""
    fault = FAULT_CASES[fault_name]
    said = escape_table_cell(find_fault_message(fault, outcome, clean_outcome)) or "–"
    errors = [format_error_cell(outcome, clean_outcome, s) for s in TABLE_SENSORS]
    what = f"{fault.description}. {fault.note}" if fault.note else fault.description
    cells = [f"`{fault_name}`", what, said, *errors, describe_consequence(outcome, clean_outcome)]
    return f"| {' | '.join(cells)} |"


def escape_table_cell(text):
    """Text as it may stand in a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


PAGE_TEMPLATE = Path(__file__).with_suffix(".md.j2")


def render_fault_page(outcomes):
    """docs/faults.md of {name: Outcome}."""
    clean = outcomes[CLEAN_NAME]
    shown = {
        s: f"{1e3 * clean.errors[s][0]:.2f} mm {np.degrees(clean.errors[s][1]):.4f}° "
        f"(σ {1e3 * clean.sigmas[s][0]:.2f} mm {np.degrees(clean.sigmas[s][1]):.4f}°)"
        for s in TABLE_SENSORS
    }
    groups = [
        {"title": title, "rows": [format_fault_row(name, outcomes[name], clean) for name in faults]}
        for title, faults in FAULT_GROUPS.items()
    ]
    return render_markdown(PAGE_TEMPLATE, **shown, most=MAX_ERROR_RATIO, groups=groups)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path, metavar="WORK", help="an own folder")
    parser.add_argument(
        "--docs", type=Path, default=small_run.ROOT / "docs", help="where it is written"
    )
    parser.add_argument("--keep", action="store_true", help="what an earlier run left in WORK")
    parser.add_argument("--cores", type=int, default=2)
    args = parser.parse_args(argv)
    found = measure_all_faults(args.work.resolve(), list(FAULT_CASES), args.keep, args.cores)
    page = args.docs / "faults.md"
    matrix = split_page(page.read_text())[1] if page.exists() else ""
    page.write_text(render_fault_page(found) + matrix)


if __name__ == "__main__":
    main()
