"""What simulator and pipeline left in their folders, held against each other.

The one place where the truth meets the pipeline's files, when all jobs are done.
"""

import json

import numpy as np
import yaml

from benchmarking.accuracy import accuracy_cases, cramer_rao_bound, error_metrics, simulation_plan
from benchmarking.accuracy.draw_statistics import Draw
from benchmarking.decode_cost import process_cost
from calib.estimation import measurement_groups, problem_assembly
from calib.estimation.residuals import residual_registry
from calib.geometry import se3
from calib.io import config, parquet_tables, table_schemas

UNKNOWN = (np.nan, np.nan), np.nan


def simulated(log, pattern):
    """The content of the one config file of a simulated log that matches."""
    (path,) = (log / "config").glob(f"{pattern}.yaml")
    return yaml.safe_load(path.read_text())


def log_file(log):
    """The one MCAP file of a simulated log."""
    (path,) = (log / "logs").resolve().glob("*.mcap")
    return path


def truth(logs, case):
    """truth.json of the log of a case."""
    return json.loads((logs / simulation_plan.log_name(*case.log) / "truth.json").read_text())


def outcomes(run, logs, cases):
    """{case: Outcome}; every method of a row is held against what the surface could tell."""
    loaded, references, out = load(run), {}, {}
    for case in sorted(cases, key=lambda c: c.method != accuracy_cases.DEFAULT):
        path, known = (
            run / simulation_plan.home(case) / simulation_plan.jobs([case])[0],
            truth(logs, case),
        )
        key = case.row.key, *case.log
        if not path.exists():
            out[case] = error_metrics.Outcome("the run stopped before a result")
            continue
        sensor = json.loads(path.read_text())["sensors"][case.row.sensor]
        if case.method == accuracy_cases.DEFAULT and sensor["T_robot_sensor"] is not None:
            references[key] = reference_of(run, case, known, loaded)
        T_true = np.array(known["sensors"][case.row.sensor]["T_robot_sensor"]["matrix"])
        out[case] = error_metrics.outcome(sensor, T_true, *references.get(key, UNKNOWN))
    return out


def load(run):
    """(config, rigs, targets) of what the default method was run with, complete."""
    folder = run / accuracy_cases.DEFAULT / "config"
    return config.load(yaml.safe_load((folder / "config.yaml").read_text()), folder)


def reference_of(run, case, known, loaded):
    """(mm, deg) that the data of a case could tell of its sensor, and the error of its pixels.

    known: truth.json of its log; loaded: the config of the run, complete.
    """
    settings, rigs, bodies = loaded
    name = case.row.sensor
    folder = run / simulation_plan.home(case) / "results" / case.name / case.name
    pairs, _, notes = parquet_tables.read(folder / "pairs.parquet", table_schemas.PAIRS)
    table, _, _ = parquet_tables.read(folder / "placements.parquet", table_schemas.PLACEMENTS)
    table["pose_factor"] = 1 / np.sqrt(table["samples"])
    options = {
        "sensors": {name: rigs[case.name]["sensors"][name]},
        "targets": {case.target: bodies[case.target]},
        "associate": settings["associate"],
    }
    noise = mocap_noise(known["arguments"])
    places = measurement_groups.still(table, case.name, options["targets"], noise)
    setup, _ = problem_assembly.setup_of({case.name: (pairs, notes, places)}, {}, options)
    true = {name: np.array(known["sensors"][name]["T_robot_sensor"]["matrix"])}
    found = cramer_rao_bound.evaluate(setup, true, known["arguments"]["range_noise_m"])
    pixels = [
        s for (_, kind), s in found.sigma.items() if residual_registry.KINDS[kind].UNIT == "px"
    ]
    return error_metrics.spread(found.covariance[name]), pixels[0] if pixels else np.nan


def full_runs(run, logs, names):
    """{sensor: Draws} of the sessions so named, each with a rig and a log of its name."""
    out = {}
    for name in names:
        path, known = run / f"results/{name}/calibration.json", logs / name / "truth.json"
        true = json.loads(known.read_text())["sensors"]
        found = json.loads(path.read_text())["sensors"] if path.exists() else dict.fromkeys(true)
        for sensor in sorted(true):
            T_true = np.array(true[sensor]["T_robot_sensor"]["matrix"])
            out.setdefault(sensor, []).append(_drawn(found[sensor], T_true))
    return out


def _drawn(sensor, T_true):
    """The Draw of one sensor of calibration.json."""
    if sensor is None or sensor["T_robot_sensor"] is None:
        return Draw(None, None)
    T = np.array(sensor["T_robot_sensor"]["matrix"])
    error = se3.se3_log(se3.inverse(T) @ T_true)
    return Draw(error, np.array(sensor["covariance"]))


def mocap_noise(arguments):
    """Block `mocap` of a rig with the noise that simulate.py was told to make."""
    parts = {"pose_sigma": "noise", "pose_bias_sigma": "bias"}
    return {
        key: {
            "xyz_m": max(arguments[f"mcs_{part}_m"], cramer_rao_bound.NO_NOISE),
            "rpy_deg": max(arguments[f"mcs_{part}_deg"], cramer_rao_bound.NO_NOISE),
        }
        for key, part in parts.items()
    }


def read_logs(results):
    """The texts of all jobs' logs below results."""
    return [path.read_text() for path in sorted(results.rglob("*.log"))]


def decode_of(logs, run, case):
    """(size of its log, memory of its decode), MB, of a case."""
    size = log_file(logs / simulation_plan.log_name(*case.log)).stat().st_size / 1e6
    found = process_cost.costs(
        read_logs(run / simulation_plan.home(case) / "results" / case.name / case.name)
    )
    return size, found["decode"].memory if "decode" in found else np.nan
