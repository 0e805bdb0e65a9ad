"""What the rules share: config slices, log fingerprints, and the code a stage depends on."""

import ast
import json
import os
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path

SCRIPTS = Path(workflow.basedir) / "scripts"

from calib.initial_guess import previous_calibration
from calib.io.logs import open_log
from calib.io.config import load
from calib.io.status import InputError, printable
from snakemake.exceptions import WorkflowError

# Jobs find the interpreter of Snakemake itself, whether or not its environment is activated.
shell.prefix(
    f"set -euo pipefail; export PATH={shlex.quote(str(Path(sys.executable).parent))}:$PATH; "
    + SHARE
)


def checked(function, *arguments):
    """function(*arguments), with a wrong input as one line of Snakemake's own."""
    try:
        return function(*arguments)
    except InputError as error:
        raise WorkflowError(printable(str(error)))


CONFIG, RIGS, TARGETS = checked(load, config)
GIVEN = {
    name: checked(previous_calibration.read, rig["guess_from"], rig)
    for name, rig in RIGS.items()
    if "guess_from" in rig
}
SESSIONS = CONFIG["sessions"]
FIGURES = ("extrinsics", "coverage", "residuals")
RIG_OF = {name: session["rig"] for name, session in SESSIONS.items()}


def sessions_of(rig):
    return sorted(s for s in SESSIONS if RIG_OF[s] == rig)


def sensors_of(rig):
    """Sensors that at least one session of the rig uses."""
    return sorted({sensor for s in sessions_of(rig) for sensor in sorted(SESSIONS[s]["sensors"])})


def targets_of(rig):
    return sorted({target for s in sessions_of(rig) for target in SESSIONS[s]["targets"]})


def log_files(w):
    return [str(p) for p in checked(open_log.files_of, SESSIONS[w.session]["log"])]


@cache
def fingerprint(session):
    return checked(open_log.fingerprint, SESSIONS[session]["log"])


def options(**slices):
    """The only config that a job sees, as JSON with sorted keys: a change elsewhere re-runs nothing."""
    return json.dumps(slices, sort_keys=True)


def decode_options(w):
    rig, session = RIGS[w.rig], SESSIONS[w.session]
    sensors = {name: heard(rig["sensors"][name]) for name in session["sensors"]}
    mocap = {k: rig["mocap"][k] for k in ("topics", "map", "max_gap_s")}
    bodies = sorted({rig["body"]} | {TARGETS[t]["body"] for t in session["targets"]})
    span = {k: session.get(k) for k in ("from_s", "to_s")}
    return options(
        log=session["log"],
        fingerprint=fingerprint(w.session),
        sensors=sensors,
        mocap=mocap,
        bodies=bodies,
        **span,
    )


def heard(sensor):
    """What decode needs to know of a sensor: of a camera's lens only what its CameraInfo is held
    against."""
    keys = ["kind", "topic", "point_time", "camera_info"]
    keys += ["model", "size_px", "rectified"] if "camera_info" in sensor else []
    return {k: sensor[k] for k in keys if k in sensor}


def gate_options(w):
    rig = RIGS[w.rig]
    mocap = {k: rig["mocap"][k] for k in ("max_gap_s", "pose_sigma")}
    bodies = {t: TARGETS[t]["body"] for t in SESSIONS[w.session]["targets"]}
    return options(gate=CONFIG["gate"], body=rig["body"], mocap=mocap, targets=bodies)


def preflight_options(w):
    rig, used = RIGS[w.rig], {s: SESSIONS[s] for s in sessions_of(w.rig)}
    keys = ("sensors", "targets", "remounted")
    return options(
        **{stage: CONFIG[stage] for stage in ("guess", "judge")},
        crop=CONFIG["crop"],
        rig=w.rig,
        body=rig["body"],
        max_gap_s=max_gap(w),
        sensors={s: rig["sensors"][s] for s in sensors_of(w.rig)},
        targets={t: TARGETS[t] for t in targets_of(w.rig)},
        given=GIVEN.get(w.rig, {}),
        sessions={name: {k: session[k] for k in keys} for name, session in used.items()},
        time_offset=clocks_wanted(w),
        target_alignment=CONFIG["solve"]["estimate"]["target_alignment"] is not False,
    )


def sensor_options(stage, w, **more):
    """The slice of a stage that runs once per sensor."""
    sensor = RIGS[w.rig]["sensors"][w.sensor]
    return options(**({stage: CONFIG[stage], "name": w.sensor, "sensor": sensor} | more))


def searched(w):
    """Whether a guess may have to look into the data: the rig does not state the sensor's pose, or
    it may not hold in this session, or a target does not state its mount."""
    session = SESSIONS[w.session]
    unknown = session["remounted"] or any("mount" in TARGETS[t] for t in session["targets"])
    return unknown or "T_robot_sensor" not in RIGS[w.rig]["sensors"][w.sensor]


def looked_into(w):
    """Whether a guess looks into the data: for the pose, a mount or the clock."""
    return clocks_wanted(w) or searched(w)


def where(wanted, pattern):
    """Input function: the pattern where that is wanted, else nothing."""
    return lambda w: expand(pattern, rig=w.rig, session=w.session) if wanted(w) else []


def guess_options(w):
    """Targets, cameras and log only where they may be needed: else no edit of theirs re-runs it."""
    session = SESSIONS[w.session]
    more = {"remounted": session["remounted"]}
    targets = {t: TARGETS[t] for t in session["targets"]}
    if looked_into(w):
        bodies = [RIGS[w.rig]["body"], *sorted({t["body"] for t in targets.values()})]
        more |= {"log": session["log"], "bodies": bodies, "max_gap_s": max_gap(w)}
    if searched(w):
        more |= {"targets": targets, "cameras": {}}
        if any("mount" in t for t in targets.values()):
            sensors = {s: RIGS[w.rig]["sensors"][s] for s in session["sensors"]}
            more["cameras"] = {s: c for s, c in sensors.items() if c["kind"] == "camera"}
        asked = {w.sensor, *more["cameras"]}
        given = {s: g for s, g in GIVEN.get(w.rig, {}).items() if s in asked}
        more |= {"given": given} if given else {}
    return sensor_options("guess", w, body=RIGS[w.rig]["body"], **more)


def crop_options(w):
    session = SESSIONS[w.session]
    targets = {t: TARGETS[t] for t in session["targets"]}
    more = {"body": RIGS[w.rig]["body"], "max_gap_s": max_gap(w)}
    return sensor_options("crop", w, targets=targets, log=session["log"], **more)


def clocks_wanted(w):
    """Whether the offsets of the clocks are to be found."""
    return CONFIG["solve"]["estimate"]["time_offset"] == "auto"


def max_gap(w):
    return RIGS[w.rig]["mocap"]["max_gap_s"]


def extract_options(w):
    targets = {t: TARGETS[t] for t in SESSIONS[w.session]["targets"]}
    more = {"associate": CONFIG["associate"], "crop": CONFIG["crop"]}
    more |= {"body": RIGS[w.rig]["body"], "max_gap_s": max_gap(w)}
    return sensor_options("extract", w, targets=targets, mocap=mocap_noise(w), **more)


def mocap_noise(w):
    return {k: RIGS[w.rig]["mocap"][k] for k in ("pose_sigma", "pose_bias_sigma")}


def associate_options(w):
    session = SESSIONS[w.session]
    sensors = {s: RIGS[w.rig]["sensors"][s] for s in session["sensors"]}
    targets = {t: TARGETS[t] for t in session["targets"]}
    blocks = {"associate": CONFIG["associate"], "mocap": mocap_noise(w)}
    return options(**blocks, sensors=sensors, targets=targets)


def solve_options(w):
    rig = RIGS[w.rig]
    return options(
        solve=CONFIG["solve"],
        associate=CONFIG["associate"],
        views={k: CONFIG["crop"][k] for k in ("min_returns", "max_incidence_deg")},
        rig=w.rig,
        mocap=mocap_noise(w),
        sensors={s: rig["sensors"][s] for s in sensors_of(w.rig)},
        targets={t: TARGETS[t] for t in targets_of(w.rig)},
        sessions=sessions_of(w.rig),
        body=rig["body"],
        max_gap_s=max_gap(w),
        remounted=[s for s in sessions_of(w.rig) if SESSIONS[s]["remounted"]],
        used={s: sorted(SESSIONS[s]["sensors"]) for s in sessions_of(w.rig)},
    )


def judge_options(w):
    return options(judge=CONFIG["judge"])


def report_options(w):
    rig = RIGS[w.rig]
    sensors = {s: rig["sensors"][s] for s in sensors_of(w.rig)}
    targets = {t: TARGETS[t] for t in targets_of(w.rig)}
    used = {s: SESSIONS[s]["sensors"] for s in sessions_of(w.rig)}
    shown = {"sensors": sensors, "targets": targets, "sessions": used}
    # No other job may ever see the truth.
    if "truth" in rig:
        shown["truth"] = rig["truth"]
    shown["settings"] = {k: v for k, v in CONFIG.items() if k not in ("sessions", "export")}
    return options(rig=w.rig, body=rig["body"], report=CONFIG["report"], **shown)


def export_options(w):
    rig, used = RIGS[w.rig], {s: SESSIONS[s]["sensors"] for s in sessions_of(w.rig)}
    keys = ("kind", "topic", "model", "size_px", "params")
    sensors = {
        s: {k: rig["sensors"][s][k] for k in keys if k in rig["sensors"][s]}
        for s in sensors_of(w.rig)
    }
    targets = {t: TARGETS[t] for t in targets_of(w.rig)}
    shown = {"sensors": sensors, "targets": targets, "sessions": used}
    return options(export=CONFIG["export"] | rig["export"], body=rig["body"], **shown)


def patched_urdf(w):
    """The URDF that export places the sensors in, if the rig names one."""
    return RIGS[w.rig]["export"].get("urdf", [])


def of_sessions(pattern):
    """Input function: the pattern for every session of the rig."""
    return lambda w: expand(pattern, rig=w.rig, session=sessions_of(w.rig))


def of_sensors(pattern):
    """Input function: the pattern for every sensor of every session of the rig, or of one session."""

    def paths(w):
        chosen = [w.session] if hasattr(w, "session") else sessions_of(w.rig)
        return [
            pattern.format(rig=w.rig, session=s, sensor=sensor)
            for s in chosen
            for sensor in sorted(SESSIONS[s]["sensors"])
        ]

    return paths


def resources(folder):
    """Templates, styles and scripts below a folder of the checkout that a job reads, relative to
    the working directory."""
    found = sorted(Path(workflow.basedir, folder).rglob("*"))
    return [os.path.relpath(p) for p in found if p.suffix in (".j2", ".css", ".js")]


@cache
def code(stage):
    """scripts/<stage>.py followed by every file of scripts/ it imports, directly or not."""
    found, todo = {}, [SCRIPTS / f"{stage}.py"]
    while todo:
        path = todo.pop()
        if path not in found:
            found[path] = None
            todo += [p for name in imports(path) for p in modules(name)]
    return [os.path.relpath(p) for p in found]


def imports(path):
    """Dotted names that a Python file imports, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            yield from [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
        elif isinstance(node, ast.Import):
            yield from (a.name for a in node.names)


def modules(name):
    """The files of scripts/ that importing a dotted name runs, packages above it included."""
    parts = name.split(".")
    for n in range(1, len(parts) + 1):
        stem = SCRIPTS.joinpath(*parts[:n])
        yield from (p for p in (stem.with_suffix(".py"), stem / "__init__.py") if p.exists())


def last_words():
    """Every rig's verdict and poses, its preflight where that was asked for, or what stopped it, as
    the last lines on the terminal; and all rigs on one page."""
    told, asked = {}, "preflight" in workflow.dag_settings.targets
    for rig in sorted(set(RIG_OF.values())):
        home = Path("results", rig)
        stopped = [line for path in sorted(home.rglob("*.log")) for line in complaint(path)]
        told[rig] = {"sessions": sessions_of(rig), "stopped": stopped}
        if stopped:
            say(f"{rig}: STOPPED", *stopped)
        elif asked and (home / "preflight.txt").exists():
            say((home / "preflight.txt").read_text())
        elif (home / "verdict.json").exists():
            page = os.path.relpath(home / "report.html", os.environ.get("PWD", "."))
            say(*results(rig, home), f"report: {page}")
    if words := no_room():
        say(words)
    elif Path("results").is_dir():
        write_index(told)


def say(*lines):
    """Print the first line, and the others below it."""
    print(*map(printable, lines), sep="\n  ", file=sys.stderr)


def write_index(rigs):
    """results/index.html: no job, for it must be there when jobs stopped, and says which."""
    command = [sys.executable, SCRIPTS / "index.py", "--results", "results"]
    command += ["--templates", *resources("workflow/report"), "--output", "results/index.html"]
    done = subprocess.run(
        [*command, "--options", options(rigs=rigs)], capture_output=True, text=True
    )
    if done.returncode:
        print(done.stderr, file=sys.stderr)


def results(rig, home):
    """The verdict of one rig and the poses of its sensors in a few lines."""
    from calib.report.page import terminal_summary  # 0.1 s, which no start should pay

    found = [json.loads((home / f"{n}.json").read_text()) for n in ("calibration", "verdict")]
    return terminal_summary.lines(*found, RIGS[rig].get("truth", {}))


def complaint(path):
    """What ended the job of a log file, if it did not end well; a failed verdict is no such end."""
    lines = path.read_text().splitlines()
    ended = [line for line in lines if line.startswith(("error: ", "Traceback"))]
    if ended and not ended[-1].endswith("is not exported, its calibration failed:"):
        yield f"{path}: {lines[-1].removeprefix('error: ')}"
