"""All faults by the name of their fixture: logs that have them, and what is said of them."""

import copy
import json
from collections import Counter
from functools import cache
from types import SimpleNamespace

import yaml

import containers
import simulate
from calib.io import parquet_tables, table_schemas
from calib.report.sections import recording_audit
from simulation import config_and_truth, record_session
from wrecks_camera import CAMERA
from wrecks_lidar import LIDAR
from wrecks_log import LOG
from wrecks_mocap import MOCAP

CLEAN = (
    "--placements 8 --hold-s 1.5 --move-s 0.7 --sector-deg 45 --camera-hz 2 --encoding mono8 "
    "--seed 11 --range-noise-m 0.01 --image-noise 1.8 --blur-px 0.7 --mcs-noise-m 0.00015 "
    "--mcs-noise-deg 0.02 --mcs-bias-m 0.00005 --mcs-bias-deg 0.005"
)
GROUPS = {
    "Motion capture": MOCAP,
    "Lidars": LIDAR,
    "Cameras": CAMERA,
    "Files, config and targets": LOG,
}
FAULTS = {name: fault for group in GROUPS.values() for name, fault in group.items()}
RESULTS = "results/sim"
USUAL = {"", "not still", "not a new pose", "enough placements", "enough frames of this placement"}


@cache
def simulated(arguments):
    """(sessions, guesses, rows of the log) of simulate.py with the clean log's arguments and
    these."""
    args = simulate.parse(["unused", *CLEAN.split(), *arguments.split()])
    sessions, guesses = simulate.draw(args)
    return sessions, guesses, list(record_session.messages(sessions[0]))


def write(folder, fault=None):
    """A working directory with the log that has a fault (None: the clean one), config and truth."""
    arguments = fault.simulated if fault else ""
    sessions, guesses, rows = simulated(arguments)
    config_and_truth.write_config(folder / "config", "sim", sessions, guesses)
    config_and_truth.write_truth(folder / "truth.json", sessions, guesses)
    (folder / "logs").mkdir(parents=True, exist_ok=True)
    rows = copy.deepcopy(rows)
    if fault and fault.damage:
        rows = fault.damage(rows)
    path = folder / "logs" / "sim"
    log = fault.write(path, rows) if fault and fault.write else one_file(path, rows)
    if fault and fault.spoil:
        whole = path.with_suffix(".mcap")
        whole.write_bytes(fault.spoil(whole.read_bytes()))
    _configure(folder / "config", fault, log, folder)
    return folder


def one_file(path, rows):
    return str(containers.mcap(path.with_suffix(".mcap"), rows, chunk_size=1 << 20))


def _configure(folder, fault, log, root):
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
    if fault and fault.config:
        fault.config(session, rig, {p.stem: t for p, t in zip(paths[2:], targets, strict=True)})
    for path, content in zip(paths, (settings, rig, *targets), strict=True):
        path.write_text(yaml.safe_dump(content, sort_keys=False))


# --- what is said


def heard(audit):
    """Sentences of log.json, as the report has them."""
    run = SimpleNamespace(sessions={"sim": SimpleNamespace(audit=audit)})
    out = [
        f"{where}: {words}" if where[0] == "/" else words
        for where, words in recording_audit.heard(run, "sim")
    ]
    for name, body in sorted(audit["bodies"].items()):
        out += [f"{name}: {n} × {kind}" for kind, n in sorted(body.get("faults", {}).items())]
        if body.get("gaps"):
            out.append(f"{name}: gaps: {body['gaps']}, up to {body['longest_gap_s']:.2f} s")
    for name, sensor in sorted(audit["sensors"].items()):
        out.append(f"{name}: {sensor['messages']} messages, {sensor['rate_hz']:.3g} Hz")
        out += [
            f"{name}: {what}: {words}" for what, words in sorted(sensor.get("told", {}).items())
        ]
    for found in [*audit["bodies"].values(), *audit["sensors"].values()]:
        out += refused(found["status"])
    return out


def refused(status):
    """The sentence of a status that is not ok."""
    if status["ok"]:
        return []
    found = f" ({status['found']})" if status["found"] else ""
    return [f"{status['reason']}{found}. {status['remedy']}".strip()]


def said(folder):
    """All sentences about the log in a working directory that was run, in order of the stages."""
    home = folder / RESULTS / "sim"
    out = heard(json.loads((home / "log.json").read_text()))
    for sensor, schema in (
        ("camera", table_schemas.VIEWS_CAMERA),
        ("velodyne", table_schemas.VIEWS_LIDAR),
    ):
        guess = json.loads((home / sensor / "guess.json").read_text())
        out += refused(guess["status"])
        views, status, _ = parquet_tables.read(home / sensor / "views.parquet", schema)
        reasons = Counter(r for r in map(str, views["reason"]) if r not in USUAL)
        out += [f"{sensor}: {n} views: {why}" for why, n in sorted(reasons.items())]
        out += refused(status.to_dict())
        _, status, notes = parquet_tables.read(
            home / sensor / "keypoints.parquet", table_schemas.KEYPOINTS
        )
        failures = Counter(
            o["status"]["reason"] for o in notes["outcomes"] if not o["status"]["ok"]
        )
        out += [f"{sensor}: {n} views: {why}" for why, n in sorted(failures.items())]
        out += refused(status.to_dict())
    out += clocks(json.loads((folder / RESULTS / "calibration.json").read_text()))
    verdict = json.loads((folder / RESULTS / "verdict.json").read_text())
    out += [f"{f['text']}: {f['remedy']}" for f in verdict["findings"]]
    return list(dict.fromkeys(out))


def clocks(calibration):
    """Sentences of calibration.json on the clocks that are off by more than chance."""
    out = []
    for name, sensor in sorted(calibration["sensors"].items()):
        late = sensor["time_offset_s"]
        if late and abs(late["value"]) > 4 * late["sigma"]:
            ms = 1e3 * late["value"], 1e3 * late["sigma"]
            out.append(f"{name}: time offset {ms[0]:.1f} ms, σ {ms[1]:.1f} ms")
        for wander in (sensor["time_wander"] or {}).values():
            drift = wander["drift_ppm"]
            out.append(f"{name}: clock drift {drift['value']:.0f} ppm, σ {drift['sigma']:.0f} ppm")
    for name, lag in sorted(calibration["mocap_offsets_s"].items()):
        ms = 1e3 * lag["value"], 1e3 * lag["sigma"]
        out.append(f"{name}: stamps {ms[0]:.1f} ms off those of the robot, σ {ms[1]:.1f} ms")
    return out
