"""All faults by the name of their fixture: logs that have them, and what is said of them."""

import copy
import json
from collections import Counter
from functools import cache

import yaml

from calib.io.parquet_tables import read_table
from calib.io.table_schemas import CAMERA_VIEWS_SCHEMA, KEYPOINTS_SCHEMA, LIDAR_VIEWS_SCHEMA
from calib.report.sections.recordings import list_log_notes
from helpers.fault_catalog.camera_faults import CAMERA_FAULTS
from helpers.fault_catalog.file_faults import FILE_FAULTS
from helpers.fault_catalog.lidar_faults import LIDAR_FAULTS
from helpers.fault_catalog.mocap_faults import MOCAP_FAULTS
from helpers.log_containers import write_test_mcap
from simulate import draw_sessions, parse_simulation_arguments
from simulation.config_and_truth import write_simulated_config, write_truth
from simulation.session_recording import generate_messages

CLEAN_ARGUMENTS = (
    "--placements 8 --hold-s 1.5 --move-s 0.7 --sector-deg 45 --camera-hz 2 --encoding mono8 "
    "--seed 11 --range-noise-m 0.01 --image-noise 1.8 --blur-px 0.7 --mcs-noise-m 0.00015 "
    "--mcs-noise-deg 0.02 --mcs-bias-m 0.00005 --mcs-bias-deg 0.005"
)
FAULT_GROUPS = {
    "Motion capture": MOCAP_FAULTS,
    "Lidars": LIDAR_FAULTS,
    "Cameras": CAMERA_FAULTS,
    "Files, config and targets": FILE_FAULTS,
}
FAULT_CASES = {name: fault for group in FAULT_GROUPS.values() for name, fault in group.items()}
RESULTS_FOLDER = "results/sim"
EXPECTED_REASONS = {
    "",
    "not still",
    "not a new pose",
    "enough placements",
    "enough frames of this placement",
}


@cache
def simulate_clean_rows(arguments):
    """(sessions, guesses, rows of the log) of simulate.py with the clean log's arguments and
    these."""
    args = parse_simulation_arguments(["unused", *CLEAN_ARGUMENTS.split(), *arguments.split()])
    sessions, guesses = draw_sessions(args)
    return sessions, guesses, list(generate_messages(sessions[0]))


def write_fault_run(folder, fault=None):
    """A working directory with the log that has a fault (None: the clean one), config and truth."""
    arguments = fault.simulate_arguments if fault else ""
    sessions, guesses, rows = simulate_clean_rows(arguments)
    write_simulated_config(folder / "config", "sim", sessions, guesses)
    write_truth(folder / "truth.json", sessions, guesses)
    (folder / "logs").mkdir(parents=True, exist_ok=True)
    rows = copy.deepcopy(rows)
    if fault and fault.damage_rows:
        rows = fault.damage_rows(rows)
    path = folder / "logs" / "sim"
    log = (
        fault.write_log(path, rows) if fault and fault.write_log else write_single_mcap(path, rows)
    )
    if fault and fault.damage_bytes:
        whole = path.with_suffix(".mcap")
        whole.write_bytes(fault.damage_bytes(whole.read_bytes()))
    _write_fault_config(folder / "config", fault, log, folder)
    return folder


def write_single_mcap(path, rows):
    return str(write_test_mcap(path.with_suffix(".mcap"), rows, chunk_size=1 << 20))


def _write_fault_config(folder, fault, log, root):
    """Make what config.yaml, the rig and the targets say fit the fault."""
    relative = [str(p).removeprefix(f"{root}/") for p in (log if isinstance(log, list) else [log])]
    paths = [
        folder / "config.yaml",
        folder / "rigs/sim.yaml",
        *sorted((folder / "targets").iterdir()),
    ]
    settings, rig, *targets = (yaml.safe_load(p.read_text()) for p in paths)
    session = settings["sessions"]["sim"]
    session["log"] = relative if isinstance(log, list) else relative[0]
    settings["crop"] = {"max_frames": 3}  # of a placement, so that all faults are done in time
    if fault and fault.change_config:
        fault.change_config(
            session, rig, {p.stem: t for p, t in zip(paths[2:], targets, strict=True)}
        )
    for path, content in zip(paths, (settings, rig, *targets), strict=True):
        path.write_text(yaml.safe_dump(content, sort_keys=False))


# --- what is said


def list_audit_messages(audit):
    """Sentences of log.json, as the report has them."""
    out = [
        f"{where}: {words}" if where[0] == "/" else words for where, words in list_log_notes(audit)
    ]
    for name, body in sorted(audit["bodies"].items()):
        out += [f"{name}: {n} × {kind}" for kind, n in sorted(body.get("faults", {}).items())]
        if body.get("gaps"):
            out.append(f"{name}: gaps: {body['gaps']}, up to {body['longest_gap_s']:.2f} s")
    for name, sensor in sorted(audit["sensors"].items()):
        out.append(f"{name}: {sensor['messages']} messages, {sensor['rate_hz']:.3g} Hz")
        out += [
            f"{name}: {what}: {words}" for what, words in sorted(sensor.get("inferred", {}).items())
        ]
    for found in [*audit["bodies"].values(), *audit["sensors"].values()]:
        out += format_failed_status(found["status"])
    return out


def format_failed_status(status):
    """The sentence of a status that is not ok."""
    if status["ok"]:
        return []
    found = f" ({status['found']})" if status["found"] else ""
    return [f"{status['reason']}{found}. {status['remedy']}".strip()]


def list_run_messages(folder):
    """All sentences about the log in a working directory that was run, in order of the stages."""
    home = folder / RESULTS_FOLDER / "sim"
    out = list_audit_messages(json.loads((home / "log.json").read_text()))
    for sensor, schema in (
        ("camera", CAMERA_VIEWS_SCHEMA),
        ("velodyne", LIDAR_VIEWS_SCHEMA),
    ):
        guess = json.loads((home / sensor / "guess.json").read_text())
        out += format_failed_status(guess["status"])
        views, status, _ = read_table(home / sensor / "views.parquet", schema)
        reasons = Counter(r for r in map(str, views["reason"]) if r not in EXPECTED_REASONS)
        out += [f"{sensor}: {n} views: {why}" for why, n in sorted(reasons.items())]
        out += format_failed_status(status.to_dict())
        _, status, notes = read_table(home / sensor / "keypoints.parquet", KEYPOINTS_SCHEMA)
        failures = Counter(
            o["status"]["reason"] for o in notes["outcomes"] if not o["status"]["ok"]
        )
        out += [f"{sensor}: {n} views: {why}" for why, n in sorted(failures.items())]
        out += format_failed_status(status.to_dict())
    out += describe_clock_errors(
        json.loads((folder / RESULTS_FOLDER / "calibration.json").read_text())
    )
    verdict = json.loads((folder / RESULTS_FOLDER / "verdict.json").read_text())
    out += [f"{f['text']}: {f['remedy']}" for f in verdict["findings"]]
    return list(dict.fromkeys(out))


def describe_clock_errors(calibration):
    """Sentences of calibration.json on the clocks that are off by more than chance."""
    out = []
    for name, sensor in sorted(calibration["sensors"].items()):
        late = sensor["time_offset_s"]
        if late and abs(late["value"]) > 4 * late["sigma"]:
            ms = 1e3 * late["value"], 1e3 * late["sigma"]
            out.append(f"{name}: time offset {ms[0]:.1f} ms, σ {ms[1]:.1f} ms")
        for wander in (sensor["clock_drift"] or {}).values():
            drift = wander["drift_ppm"]
            out.append(f"{name}: clock drift {drift['value']:.0f} ppm, σ {drift['sigma']:.0f} ppm")
    for name, lag in sorted(calibration["mocap_offsets_s"].items()):
        ms = 1e3 * lag["value"], 1e3 * lag["sigma"]
        out.append(f"{name}: stamps {ms[0]:.1f} ms off those of the robot, σ {ms[1]:.1f} ms")
    return out
