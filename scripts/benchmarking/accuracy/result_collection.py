"""Read the files of simulator and pipeline, and compare the results with the truth.

Only this module reads both the truth and the results, after all jobs are done.
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
    """Return the content of the only config file of a simulated log that matches a pattern."""
    (path,) = (log_folder / "config").glob(f"{path_pattern}.yaml")
    return yaml.safe_load(path.read_text())


def find_log_file(log_folder: Path) -> Path:
    """Return the only MCAP file of a simulated log."""
    (path,) = (log_folder / "logs").resolve().glob("*.mcap")
    return path


def read_case_truth(logs: Path, case: AccuracyCase) -> dict[str, Any]:
    """Return truth.json of the log of a case."""
    return json.loads((logs / simulated_log_name(*case.log_key) / "truth.json").read_text())


def collect_outcomes(
    run: Path, logs: Path, cases: list[AccuracyCase]
) -> dict[AccuracyCase, CalibrationOutcome]:
    """Return the outcomes by case.

    All methods of a row get the reference accuracy of the data of the default method.
    """
    run_config, references, out = load_run_config(run), {}, {}
    for case in sorted(cases, key=lambda c: c.method != DEFAULT_METHOD):
        path = run / case_folder(case) / calibration_paths([case])[0]
        truth = read_case_truth(logs, case)
        key = case.row.key, *case.log_key
        if not path.exists():
            out[case] = CalibrationOutcome("the run stopped before a result")
            continue
        sensor = json.loads(path.read_text())["sensors"][case.row.sensor]
        if case.method == DEFAULT_METHOD and sensor["T_robot_sensor"] is not None:
            references[key] = compute_case_reference(run, case, truth, run_config)
        T_true = np.array(truth["sensors"][case.row.sensor]["T_robot_sensor"]["matrix"])
        out[case] = evaluate_sensor_result(sensor, T_true, *references.get(key, NO_REFERENCE))
    return out


def load_run_config(run: Path) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return the complete config, rigs and targets of the run of the default method."""
    folder = run / DEFAULT_METHOD / "config"
    return load_config(yaml.safe_load((folder / "config.yaml").read_text()), folder)


def compute_case_reference(
    run: Path,
    case: AccuracyCase,
    truth: dict[str, Any],
    run_config: tuple[dict[str, Any], dict[str, Any], dict[str, Any]],
) -> tuple[tuple[float, float], float]:
    """Return the reference accuracy (mm, deg) of the data of a case, and its pixel error, px, rms.

    truth: truth.json of its log; run_config: complete config, rigs and targets of the run. The
    pixel error is NaN where no camera is used.
    """
    settings, rigs, target_configs = run_config
    name = case.row.sensor
    options = {
        "sensors": {name: rigs[case.case_name]["sensors"][name]},
        "targets": {case.target_name: target_configs[case.target_name]},
        "associate": settings["associate"],
    }
    setup, _ = build_setup([_read_session_keypoints(run, case, truth, options)], {}, options)
    T_true = {name: np.array(truth["sensors"][name]["T_robot_sensor"]["matrix"])}
    bound = compute_cramer_rao_bound(setup, T_true, truth["arguments"]["range_noise_m"])
    pixels = [
        s for (_, kind), s in bound.measurement_sigma.items() if RESIDUAL_KINDS[kind].UNIT == "px"
    ]
    return sigma_mm_deg(bound.covariance[name]), pixels[0] if pixels else np.nan


def _read_session_keypoints(
    run: Path, case: AccuracyCase, truth: dict[str, Any], options: dict[str, Any]
) -> SessionKeypoints:
    """Read the assigned keypoints of a case, with the true noise of the MCS in its placements."""
    folder = run / case_folder(case) / "results" / case.case_name / case.case_name
    pairs, _, notes = read_table(folder / "pairs.parquet", PAIRS_SCHEMA)
    table, _, _ = read_table(folder / "placements.parquet", PLACEMENTS_SCHEMA)
    table["mean_pose_sigma_factor"] = 1 / np.sqrt(table["samples"])
    placements = make_still_placements(
        table,
        case.case_name,
        targets=options["targets"],
        mocap_noise=mocap_noise_json(truth["arguments"]),
    )
    return SessionKeypoints(
        session=case.case_name,
        keypoints=pairs,
        placements=placements,
        T_robot_sensor={
            n: np.array(note["T_robot_sensor"])
            for n, note in notes.items()
            if note["T_robot_sensor"] is not None
        },
    )


def collect_full_runs(
    run: Path, logs: Path, session_names: list[str]
) -> dict[str, list[DrawResult]]:
    """Return the results by sensor of the sessions that ran through the whole pipeline.

    The rig and the log of a session have its name.
    """
    out: dict[str, list[DrawResult]] = {}
    for name in session_names:
        path = run / f"results/{name}/calibration.json"
        truth = json.loads((logs / name / "truth.json").read_text())["sensors"]
        results = json.loads(path.read_text())["sensors"] if path.exists() else dict.fromkeys(truth)
        for sensor in sorted(truth):
            T_true = np.array(truth[sensor]["T_robot_sensor"]["matrix"])
            out.setdefault(sensor, []).append(_sensor_draw_result(results[sensor], T_true))
    return out


def _sensor_draw_result(sensor: dict[str, Any] | None, T_true: np.ndarray) -> DrawResult:
    """Return error and covariance of one sensor of calibration.json, None if it is missing."""
    if sensor is None or sensor["T_robot_sensor"] is None:
        return DrawResult(None, None)
    T = np.array(sensor["T_robot_sensor"]["matrix"])
    error = se3_log(invert_pose(T) @ T_true)
    return DrawResult(error, np.array(sensor["covariance"]))


def mocap_noise_json(simulation_arguments: dict[str, Any]) -> dict[str, Any]:
    """Return block `mocap` of a rig with the true noise, from the arguments of simulate.py."""
    parts = {"pose_sigma": "noise", "pose_bias_sigma": "bias"}
    return {
        key: {
            "xyz_m": max(simulation_arguments[f"mcs_{part}_m"], MIN_TRUE_SIGMA),
            "rpy_deg": max(simulation_arguments[f"mcs_{part}_deg"], MIN_TRUE_SIGMA),
        }
        for key, part in parts.items()
    }


def read_job_logs(results: Path) -> list[str]:
    """Return the texts of the logs of all jobs in a results folder."""
    return [path.read_text() for path in sorted(results.rglob("*.log"))]


def read_decode_memory(logs: Path, run: Path, case: AccuracyCase) -> tuple[float, float]:
    """Return the size of the log of a case and the peak memory of its decode job, MB."""
    size = find_log_file(logs / simulated_log_name(*case.log_key)).stat().st_size / 1e6
    costs = parse_stage_costs(
        read_job_logs(run / case_folder(case) / "results" / case.case_name / case.case_name)
    )
    return size, costs["decode"].peak_memory_mb if "decode" in costs else np.nan
