"""What simulator and pipeline left in their folders, held against each other.

The one place where the truth meets the pipeline's files, when all jobs are done.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarking.accuracy.accuracy_cases import DEFAULT_METHOD, AccuracyCase
from benchmarking.accuracy.cramer_rao_bound import MIN_TRUE_SIGMA, compute_cramer_rao_bound
from benchmarking.accuracy.draw_statistics import DrawResult
from benchmarking.accuracy.error_metrics import (
    CalibrationOutcome,
    evaluate_sensor_result,
    sigma_mm_deg,
)
from benchmarking.accuracy.simulation_plan import calibration_paths, case_folder, simulated_log_name
from benchmarking.decode_cost.process_cost import parse_stage_costs
from calib.estimation.measurement_groups import make_still_placements
from calib.estimation.problem_assembly import SessionKeypoints, build_setup
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.geometry.se3 import invert_pose, se3_log
from calib.io.config import load_config
from calib.io.parquet_tables import read_table
from calib.io.table_schemas import PAIRS_SCHEMA, PLACEMENTS_SCHEMA

NO_REFERENCE = (np.nan, np.nan), np.nan


def read_simulated_config(log_folder: Path, path_pattern: str) -> dict[str, Any]:
    """The content of the one config file of a simulated log that matches."""
    (path,) = (log_folder / "config").glob(f"{path_pattern}.yaml")
    return yaml.safe_load(path.read_text())


def find_log_file(log_folder: Path) -> Path:
    """The one MCAP file of a simulated log."""
    (path,) = (log_folder / "logs").resolve().glob("*.mcap")
    return path


def read_case_truth(logs: Path, case: AccuracyCase) -> dict[str, Any]:
    """truth.json of the log of a case."""
    return json.loads((logs / simulated_log_name(*case.log_key) / "truth.json").read_text())


def collect_outcomes(
    run: Path, logs: Path, cases: list[AccuracyCase]
) -> dict[AccuracyCase, CalibrationOutcome]:
    """{case: Outcome}; every method of a row is held against what the surface could tell."""
    loaded, references, out = load_run_config(run), {}, {}
    for case in sorted(cases, key=lambda c: c.method != DEFAULT_METHOD):
        path, known = (
            run / case_folder(case) / calibration_paths([case])[0],
            read_case_truth(logs, case),
        )
        key = case.row.key, *case.log_key
        if not path.exists():
            out[case] = CalibrationOutcome("the run stopped before a result")
            continue
        sensor = json.loads(path.read_text())["sensors"][case.row.sensor]
        if case.method == DEFAULT_METHOD and sensor["T_robot_sensor"] is not None:
            references[key] = compute_case_reference(run, case, known, loaded)
        T_true = np.array(known["sensors"][case.row.sensor]["T_robot_sensor"]["matrix"])
        out[case] = evaluate_sensor_result(sensor, T_true, *references.get(key, NO_REFERENCE))
    return out


def load_run_config(run: Path) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """(config, rigs, targets) of what the default method was run with, complete."""
    folder = run / DEFAULT_METHOD / "config"
    return load_config(yaml.safe_load((folder / "config.yaml").read_text()), folder)


def compute_case_reference(
    run: Path,
    case: AccuracyCase,
    truth: dict[str, Any],
    run_config: tuple[dict[str, Any], dict[str, Any], dict[str, Any]],
) -> tuple[tuple[float, float], float]:
    """(mm, deg) that the data of a case could tell of its sensor, and the error of its pixels.

    truth: truth.json of its log; run_config: the config of the run, complete.
    """
    settings, rigs, bodies = run_config
    name = case.row.sensor
    folder = run / case_folder(case) / "results" / case.case_name / case.case_name
    pairs, _, notes = read_table(folder / "pairs.parquet", PAIRS_SCHEMA)
    table, _, _ = read_table(folder / "placements.parquet", PLACEMENTS_SCHEMA)
    table["mean_pose_sigma_factor"] = 1 / np.sqrt(table["samples"])
    options = {
        "sensors": {name: rigs[case.case_name]["sensors"][name]},
        "targets": {case.target_name: bodies[case.target_name]},
        "associate": settings["associate"],
    }
    noise = mocap_noise_json(truth["arguments"])
    places = make_still_placements(
        table, case.case_name, targets=options["targets"], mocap_noise=noise
    )
    session = SessionKeypoints(
        session=case.case_name,
        keypoints=pairs,
        placements=places,
        T_robot_sensor={
            n: np.array(note["T_robot_sensor"])
            for n, note in notes.items()
            if note["T_robot_sensor"] is not None
        },
    )
    setup, _ = build_setup([session], {}, options)
    true = {name: np.array(truth["sensors"][name]["T_robot_sensor"]["matrix"])}
    found = compute_cramer_rao_bound(setup, true, truth["arguments"]["range_noise_m"])
    pixels = [
        s for (_, kind), s in found.measurement_sigma.items() if RESIDUAL_KINDS[kind].UNIT == "px"
    ]
    return sigma_mm_deg(found.covariance[name]), pixels[0] if pixels else np.nan


def collect_full_runs(
    run: Path, logs: Path, session_names: list[str]
) -> dict[str, list[DrawResult]]:
    """{sensor: Draws} of the sessions so named, each with a rig and a log of its name."""
    out: dict[str, list[DrawResult]] = {}
    for name in session_names:
        path, known = run / f"results/{name}/calibration.json", logs / name / "truth.json"
        true = json.loads(known.read_text())["sensors"]
        found = json.loads(path.read_text())["sensors"] if path.exists() else dict.fromkeys(true)
        for sensor in sorted(true):
            T_true = np.array(true[sensor]["T_robot_sensor"]["matrix"])
            out.setdefault(sensor, []).append(_sensor_draw_result(found[sensor], T_true))
    return out


def _sensor_draw_result(sensor: dict[str, Any] | None, T_true: np.ndarray) -> DrawResult:
    """The Draw of one sensor of calibration.json."""
    if sensor is None or sensor["T_robot_sensor"] is None:
        return DrawResult(None, None)
    T = np.array(sensor["T_robot_sensor"]["matrix"])
    error = se3_log(invert_pose(T) @ T_true)
    return DrawResult(error, np.array(sensor["covariance"]))


def mocap_noise_json(simulation_arguments: dict[str, Any]) -> dict[str, Any]:
    """Block `mocap` of a rig with the noise that simulate.py was told to make."""
    parts = {"pose_sigma": "noise", "pose_bias_sigma": "bias"}
    return {
        key: {
            "xyz_m": max(simulation_arguments[f"mcs_{part}_m"], MIN_TRUE_SIGMA),
            "rpy_deg": max(simulation_arguments[f"mcs_{part}_deg"], MIN_TRUE_SIGMA),
        }
        for key, part in parts.items()
    }


def read_job_logs(results: Path) -> list[str]:
    """The texts of all jobs' logs below results."""
    return [path.read_text() for path in sorted(results.rglob("*.log"))]


def read_decode_memory(logs: Path, run: Path, case: AccuracyCase) -> tuple[float, float]:
    """(size of its log, memory of its decode), MB, of a case."""
    size = find_log_file(logs / simulated_log_name(*case.log_key)).stat().st_size / 1e6
    found = parse_stage_costs(
        read_job_logs(run / case_folder(case) / "results" / case.case_name / case.case_name)
    )
    return size, found["decode"].peak_memory_mb if "decode" in found else np.nan
