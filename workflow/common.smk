"""Helpers of the rules: the config slice of each job, fingerprints of logs, the code of a stage."""

import ast
import json
import os
import shlex
import sys
from functools import cache
from pathlib import Path

SCRIPT_FOLDER = Path(workflow.basedir) / "scripts"

from calib.initial_guess.previous_calibration import read_previous_calibration
from calib.io.logs.open_log import find_log_files, fingerprint_log
from calib.io.config import load_config
from calib.io.status import InputError, escape_control_characters
from snakemake.exceptions import WorkflowError

# Jobs use the Python of Snakemake itself; its environment need not be activated. BLAS runs on one
# thread: the order of its sums depends on the number of threads, and jobs run in parallel anyway.
# Each thread of a large machine would reserve address space, which is limited: MALLOC_ARENA_MAX.
MAX_JOB_MEMORY_MB = 4000  # address space of a job; libraries take about 900
BLAS_THREADS = "OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 MALLOC_ARENA_MAX=2"
shell.prefix(
    f"set -euo pipefail; export PATH={shlex.quote(str(Path(sys.executable).parent))}:$PATH "
    f"{BLAS_THREADS}; "
    # A machine may allow less; macOS has no such limit.
    "limit_memory() {{ ulimit -v $(($1 * 1024)) 2> /dev/null || true; }}; "
)


def stop_on_input_error(function, *arguments):
    """Return function(*arguments); an InputError stops Snakemake with one line."""
    try:
        return function(*arguments)
    except InputError as error:
        raise WorkflowError(escape_control_characters(str(error)))


NOISE_KEYS = ("pose_sigma", "pose_bias_sigma")
CONFIG, RIGS, TARGETS = stop_on_input_error(load_config, config)
PREVIOUS_POSES = {
    name: stop_on_input_error(read_previous_calibration, rig["guess_from"], rig)
    for name, rig in RIGS.items()
    if "guess_from" in rig
}
SESSIONS = CONFIG["sessions"]
REPORT_FIGURES = ("extrinsics", "coverage", "residuals")
RIG_BY_SESSION = {name: session["rig"] for name, session in SESSIONS.items()}


def list_rig_sessions(rig):
    """List the sessions of a rig."""
    return sorted(s for s in SESSIONS if RIG_BY_SESSION[s] == rig)


def list_rig_sensors(rig):
    """List the sensors that at least one session of the rig uses."""
    return sorted(
        {sensor for s in list_rig_sessions(rig) for sensor in sorted(SESSIONS[s]["sensors"])}
    )


def list_rig_targets(rig):
    """List the targets that at least one session of the rig uses."""
    return sorted({target for s in list_rig_sessions(rig) for target in SESSIONS[s]["targets"]})


def session_log_files(wildcards):
    """List the files of the log of a session."""
    return [str(p) for p in stop_on_input_error(find_log_files, SESSIONS[wildcards.session]["log"])]


@cache
def session_fingerprint(session):
    """Return name, size and hash of the log files of a session: a changed log re-runs everything."""
    return stop_on_input_error(fingerprint_log, SESSIONS[session]["log"])


def options_json(**slices):
    """Return the config slice of a job as JSON with sorted keys; other changes do not re-run it."""
    return json.dumps(slices, sort_keys=True)


def decode_options(wildcards):
    rig, session = RIGS[wildcards.rig], SESSIONS[wildcards.session]
    sensors = {name: decode_slice(rig["sensors"][name]) for name in session["sensors"]}
    keys = ("topics", "map", "max_gap_s", "unit", "quaternions")
    mocap = {k: rig["mocap"][k] for k in keys}
    bodies = sorted({rig["body"]} | {TARGETS[t]["body"] for t in session["targets"]})
    span = {k: session.get(k) for k in ("from_s", "to_s")}
    return options_json(
        log=session["log"],
        fingerprint=session_fingerprint(wildcards.session),
        sensors=sensors,
        mocap=mocap,
        bodies=bodies,
        **span,
    )


def decode_slice(sensor):
    """Return the keys of a sensor block that decode needs; of a lens, those checked with CameraInfo."""
    keys = ["kind", "topic", "point_time", "camera_info"]
    keys += ["model", "size_px", "rectified"] if "camera_info" in sensor else []
    return {k: sensor[k] for k in keys if k in sensor}


def gate_options(wildcards):
    rig = RIGS[wildcards.rig]
    mocap = {k: rig["mocap"][k] for k in ("max_gap_s", *NOISE_KEYS, "use_measured_noise")}
    bodies = {t: TARGETS[t]["body"] for t in SESSIONS[wildcards.session]["targets"]}
    return options_json(gate=CONFIG["gate"], body=rig["body"], mocap=mocap, targets=bodies)


def preflight_options(wildcards):
    rig, used = RIGS[wildcards.rig], {s: SESSIONS[s] for s in list_rig_sessions(wildcards.rig)}
    keys = ("sensors", "targets", "remounted")
    return options_json(
        **{stage: CONFIG[stage] for stage in ("guess", "judge")},
        crop=CONFIG["crop"],
        rig=wildcards.rig,
        body=rig["body"],
        max_gap_s=rig_max_gap_s(wildcards),
        sensors={s: rig["sensors"][s] for s in list_rig_sensors(wildcards.rig)},
        targets={t: TARGETS[t] for t in list_rig_targets(wildcards.rig)},
        previous_poses=PREVIOUS_POSES.get(wildcards.rig, {}),
        sessions={name: {k: session[k] for k in keys} for name, session in used.items()},
        time_offset=estimates_clocks(wildcards),
        target_alignment=CONFIG["solve"]["estimate"]["target_alignment"] is not False,
    )


def sensor_options(stage, wildcards, **more):
    """Return the config slice of a stage that runs once per sensor."""
    sensor = RIGS[wildcards.rig]["sensors"][wildcards.sensor]
    return options_json(
        **({stage: CONFIG[stage], "name": wildcards.sensor, "sensor": sensor} | more)
    )


def may_search_pose(wildcards):
    """Return whether guess may search the sensor's pose in the data.

    It may if the rig does not state the pose, if the markers were re-attached in this session, or if
    the mount of a target is unknown.
    """
    session = SESSIONS[wildcards.session]
    unknown = session["remounted"] or any("mount" in TARGETS[t] for t in session["targets"])
    return unknown or "T_robot_sensor" not in RIGS[wildcards.rig]["sensors"][wildcards.sensor]


def guess_reads_log(wildcards):
    """Return whether guess reads the log: for the pose, a mount or the time offset."""
    return estimates_clocks(wildcards) or may_search_pose(wildcards)


def input_if(condition, pattern):
    """Return an input function: the pattern if the condition is true, else nothing."""

    def paths(wildcards):
        if not condition(wildcards):
            return []
        return expand(pattern, rig=wildcards.rig, session=wildcards.session)

    return paths


def guess_options(wildcards):
    """Return the slice of guess: targets, cameras and log only if needed, so that edits of them do
    not re-run it."""
    session = SESSIONS[wildcards.session]
    more = {"remounted": session["remounted"]}
    targets = {t: TARGETS[t] for t in session["targets"]}
    if guess_reads_log(wildcards):
        bodies = [RIGS[wildcards.rig]["body"], *sorted({t["body"] for t in targets.values()})]
        more |= {"log": session["log"], "bodies": bodies, "max_gap_s": rig_max_gap_s(wildcards)}
    if may_search_pose(wildcards):
        more |= {"targets": targets, "cameras": {}}
        if any("mount" in t for t in targets.values()):
            sensors = {s: RIGS[wildcards.rig]["sensors"][s] for s in session["sensors"]}
            more["cameras"] = {s: c for s, c in sensors.items() if c["kind"] == "camera"}
        asked = {wildcards.sensor, *more["cameras"]}
        previous = {s: g for s, g in PREVIOUS_POSES.get(wildcards.rig, {}).items() if s in asked}
        more |= {"previous_poses": previous} if previous else {}
    return sensor_options("guess", wildcards, body=RIGS[wildcards.rig]["body"], **more)


def crop_options(wildcards):
    session = SESSIONS[wildcards.session]
    targets = {t: TARGETS[t] for t in session["targets"]}
    more = {"body": RIGS[wildcards.rig]["body"], "max_gap_s": rig_max_gap_s(wildcards)}
    return sensor_options("crop", wildcards, targets=targets, log=session["log"], **more)


def estimates_clocks(wildcards):
    """Return whether time offsets are estimated."""
    return CONFIG["solve"]["estimate"]["time_offset"] == "auto"


def rig_max_gap_s(wildcards):
    return RIGS[wildcards.rig]["mocap"]["max_gap_s"]


def extract_options(wildcards):
    targets = {t: TARGETS[t] for t in SESSIONS[wildcards.session]["targets"]}
    more = {"associate": CONFIG["associate"], "crop": CONFIG["crop"], "guess": CONFIG["guess"]}
    more |= {"body": RIGS[wildcards.rig]["body"], "max_gap_s": rig_max_gap_s(wildcards)}
    more |= {"log": SESSIONS[wildcards.session]["log"]}
    more |= {"quaternions": RIGS[wildcards.rig]["mocap"]["quaternions"]}
    return sensor_options(
        "extract", wildcards, targets=targets, mocap=mocap_noise_slice(wildcards), **more
    )


def mocap_noise_slice(wildcards):
    return {k: RIGS[wildcards.rig]["mocap"][k] for k in NOISE_KEYS}


def associate_options(wildcards):
    session = SESSIONS[wildcards.session]
    sensors = {s: RIGS[wildcards.rig]["sensors"][s] for s in session["sensors"]}
    targets = {t: TARGETS[t] for t in session["targets"]}
    blocks = {"associate": CONFIG["associate"], "mocap": mocap_noise_slice(wildcards)}
    return options_json(**blocks, sensors=sensors, targets=targets)


def solve_options(wildcards):
    rig = RIGS[wildcards.rig]
    return options_json(
        solve=CONFIG["solve"],
        associate=CONFIG["associate"],
        views={k: CONFIG["crop"][k] for k in ("min_returns", "max_incidence_deg")},
        rig=wildcards.rig,
        mocap=mocap_noise_slice(wildcards),
        sensors={s: rig["sensors"][s] for s in list_rig_sensors(wildcards.rig)},
        targets={t: TARGETS[t] for t in list_rig_targets(wildcards.rig)},
        sessions=list_rig_sessions(wildcards.rig),
        body=rig["body"],
        max_gap_s=rig_max_gap_s(wildcards),
        remounted=[s for s in list_rig_sessions(wildcards.rig) if SESSIONS[s]["remounted"]],
        cut_sessions=[s for s in list_rig_sessions(wildcards.rig) if SESSIONS[s]["is_part"]],
        used={s: sorted(SESSIONS[s]["sensors"]) for s in list_rig_sessions(wildcards.rig)},
    )


def judge_options(wildcards):
    return options_json(judge=CONFIG["judge"], sessions=list_rig_sessions(wildcards.rig))


def report_options(wildcards):
    rig = RIGS[wildcards.rig]
    sensors = {s: rig["sensors"][s] for s in list_rig_sensors(wildcards.rig)}
    targets = {t: TARGETS[t] for t in list_rig_targets(wildcards.rig)}
    used = {s: SESSIONS[s]["sensors"] for s in list_rig_sessions(wildcards.rig)}
    shown = {"sensors": sensors, "targets": targets, "sessions": used}
    # Only the report may see the ground truth.
    if "truth" in rig:
        shown["truth"] = rig["truth"]
    shown["settings"] = {k: v for k, v in CONFIG.items() if k not in ("sessions", "export")}
    return options_json(rig=wildcards.rig, body=rig["body"], report=CONFIG["report"], **shown)


def export_options(wildcards):
    rig, used = RIGS[wildcards.rig], {
        s: SESSIONS[s]["sensors"] for s in list_rig_sessions(wildcards.rig)
    }
    keys = ("kind", "topic", "model", "size_px", "params")
    sensors = {
        s: {k: rig["sensors"][s][k] for k in keys if k in rig["sensors"][s]}
        for s in list_rig_sensors(wildcards.rig)
    }
    targets = {t: TARGETS[t] for t in list_rig_targets(wildcards.rig)}
    shown = {"sensors": sensors, "targets": targets, "sessions": used}
    return options_json(export=CONFIG["export"] | rig["export"], body=rig["body"], **shown)


def export_urdf_path(wildcards):
    """Return the path of the URDF that export updates, if the rig names one."""
    return RIGS[wildcards.rig]["export"].get("urdf", [])


def inputs_per_session(pattern):
    """Return an input function: the pattern for every session of the rig."""
    return lambda wildcards: expand(
        pattern, rig=wildcards.rig, session=list_rig_sessions(wildcards.rig)
    )


def inputs_per_sensor(pattern):
    """Return an input function: the pattern for every sensor of one session, or of all of a rig."""

    def paths(wildcards):
        chosen = (
            [wildcards.session]
            if hasattr(wildcards, "session")
            else list_rig_sessions(wildcards.rig)
        )
        return [
            pattern.format(rig=wildcards.rig, session=s, sensor=sensor)
            for s in chosen
            for sensor in sorted(SESSIONS[s]["sensors"])
        ]

    return paths


def find_page_resources(folder):
    """List templates, styles and scripts below a folder of the checkout, relative to the working
    directory."""
    found = sorted(Path(workflow.basedir, folder).rglob("*"))
    return [os.path.relpath(p) for p in found if p.suffix in (".j2", ".css", ".js")]


@cache
def find_stage_code(stage):
    """List scripts/<stage>.py, then every file of scripts/ that it imports, directly or not."""
    found, todo = {}, [SCRIPT_FOLDER / f"{stage}.py"]
    while todo:
        path = todo.pop()
        if path not in found:
            found[path] = None
            todo += [p for name in list_imports(path) for p in list_module_files(name)]
    return [os.path.relpath(p) for p in found]


def list_imports(path):
    """Yield the dotted names that a Python file imports, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            yield from [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
        elif isinstance(node, ast.Import):
            yield from (a.name for a in node.names)


def list_module_files(name):
    """Yield the files of scripts/ that importing a dotted name runs, with its parent packages."""
    parts = name.split(".")
    for n in range(1, len(parts) + 1):
        stem = SCRIPT_FOLDER.joinpath(*parts[:n])
        yield from (p for p in (stem.with_suffix(".py"), stem / "__init__.py") if p.exists())
