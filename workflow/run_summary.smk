"""The last lines of a run on the terminal, and the page of all rigs."""

import subprocess

# How the line begins that ended a job: the last one is of C++, without memory.
ENDING_LINES = ("error: ", "Traceback", "terminate called")


def print_summary():
    """Print the last lines on the terminal, and write the page of all rigs.

    Per rig: verdict and poses, the preflight text if it was requested, or the errors of its jobs.
    """
    rigs, preflight_requested = {}, "preflight" in workflow.dag_settings.targets
    for rig in sorted(set(RIG_BY_SESSION.values())):
        home = Path("results", rig)
        errors = [line for path in sorted(home.rglob("*.log")) for line in error_line(path)]
        rigs[rig] = {"sessions": list_rig_sessions(rig), "stopped": errors}
        if errors:
            print_lines(f"{rig}: STOPPED", *errors)
        elif preflight_requested and (home / "preflight.txt").exists():
            print(escape_control_characters((home / "preflight.txt").read_text()), file=sys.stderr)
        elif (home / "verdict.json").exists():
            page = os.path.relpath(home / "report.html", os.environ.get("PWD", "."))
            print_lines(*rig_result_lines(rig, home), f"report: {page}")
    if is_disk_full():
        print_lines(disk_full_message(Path.cwd()))
    elif Path("results").is_dir():
        write_rigs_page(rigs)


def print_lines(*lines):
    """Print the first line, and the others indented below it."""
    shown = (escape_control_characters(" ".join(line.splitlines())) for line in lines)
    print(*shown, sep="\n  ", file=sys.stderr)


def write_rigs_page(rigs):
    """Write results/index.html. It is no job: it also lists the jobs that stopped."""
    command = [sys.executable, SCRIPT_FOLDER / "index.py", "--results", "results"]
    command += ["--templates", *find_page_resources("workflow/report")]
    command += ["--output", "results/index.html", "--options", options_json(rigs=rigs)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        print(done.stderr, file=sys.stderr)


def rig_result_lines(rig, home):
    """Return the verdict of one rig and the poses of its sensors in a few lines."""
    # Takes 0.1 s, and only the end of a run needs it.
    from calib.report.page.terminal_summary import format_terminal_summary

    calibration, verdict = (
        json.loads((home / f"{name}.json").read_text()) for name in ("calibration", "verdict")
    )
    return format_terminal_summary(calibration, verdict, RIGS[rig].get("truth", {}))


def error_line(path):
    """Yield the error that ended the job of a log file, if any; a failed verdict is not an error."""
    lines = path.read_text().splitlines()
    ended = [line for line in lines if line.startswith(ENDING_LINES)]
    if ended and "the verdict is fail, so nothing is exported" not in ended[-1]:
        yield f"{path}: {lines[-1].removeprefix('error: ')}"
