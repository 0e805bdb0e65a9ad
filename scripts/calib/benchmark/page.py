"""The benchmark's tables and what they fall short of, as Markdown; all words follow the numbers."""

import numpy as np
from scipy.stats import chi2

from calib.benchmark import cost, measure
from calib.benchmark.rows import DEFAULT, ENSEMBLE, NOT_ESTIMATED, SINGLE

COLUMNS = ("case", "N", "method", "logs", "error", "σ reported", "NEES/6", "reference", "goal")
COLUMNS += ("error / goal", "paper", "C++")
SPEED_GOALS = {"wall": 14.0, "solve": 1.0, "memory": 600}  # s, s, MB
RAW_GOAL = 1.5  # time of decode over that of mcap's own reader
UNITS = (" mm", "°")


def digits(x):
    """x to two significant digits, without an exponent; a dash for nothing."""
    if x is None or not np.isfinite(x):
        return "–"
    return np.format_float_positional(x, precision=2, fractional=False, trim="-")


def both(figure):
    """(mm, deg) as text."""
    if figure is None or not np.all(np.isfinite(figure)):
        return "–"
    return " ".join(digits(x) + unit for x, unit in zip(figure, UNITS, strict=True))


def table(head, rows):
    """A Markdown table of texts."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def accuracy(lines):
    """The accuracy table of Lines."""
    return table(COLUMNS, [accuracy_row(line) for line in lines])


def accuracy_row(line):
    row, held = line.row, line.method == DEFAULT
    goal = measure.goal(line)
    return [
        row.title,
        str(line.n),
        line.method,
        str(line.logs) + (f" of {line.logs + len(line.lost)}" if line.lost else ""),
        both(line.error),
        both(line.sigma),
        "–" if row.exact else digits(line.nees),
        "no noise" if row.exact else both(line.reference),
        both(goal) if held else "–",
        ratio(line.error, goal) if held else "–",
        both(row.paper.get(line.n)),
        both(row.cpp.get(line.method, {}).get(line.n)),
    ]


def ratio(error, goal):
    """error / goal of (mm, deg) as text."""
    both_known = np.all(np.isfinite([error, goal]))
    return " ".join(digits(x) for x in np.divide(error, goal)) if both_known else "–"


def short_of(line):
    """Sentences on what a line does not reach; only the default method is held to the goals."""
    if line.method != DEFAULT:
        return []
    where = f"{line.row.title}, N = {line.n}"
    out = [f"{where}: a log without a pose: {reason}" for reason in line.lost]
    if not line.logs:
        return out
    own = "" if line.row.goal else f" ({ENSEMBLE} × the reference)"
    for got, goal, unit in zip(line.error, measure.goal(line), UNITS, strict=True):
        if not got <= goal:
            factor = digits(got / goal)
            out.append(
                f"{where}: {digits(got)}{unit} is {factor} × the goal, {digits(goal)}{unit}{own}"
            )
    if line.row.goal is None and not line.worst <= SINGLE:
        out.append(
            f"{where}: one log errs by {digits(line.worst)} × its reference, goal {SINGLE:g} ×"
        )
    return out + _nees(line, where)


def _nees(line, where):
    low, high = nees_band(line.logs)
    if line.row.exact or low <= line.nees <= high:
        return []
    band = f"{digits(low)} to {digits(high)}"
    return [f"{where}: NEES/6 is {digits(line.nees)}; 95 % of honest ones of {line.logs} logs "
            f"lie in {band}"]  # fmt: skip


def nees_band(logs):
    """95 % band of the mean of NEES/6 over so many logs."""
    return tuple(chi2.ppf([0.025, 0.975], 6 * logs) / (6 * logs))


def speed(run):
    """The cost table of a cost.Speed."""
    rows = [
        [stage, str(c.jobs), f"{c.wall:.1f}", f"{c.cpu:.1f}", str(c.memory)]
        for stage, c in run.costs.items()
    ]
    sums = [sum(getattr(c, k) for c in run.costs.values()) for k in ("jobs", "wall", "cpu")]
    most = str(max((c.memory for c in run.costs.values()), default=0))
    rows.append(["all", str(sums[0]), f"{sums[1]:.1f}", f"{sums[2]:.1f}", most])
    head = ("stage", "jobs", "wall, s", "CPU, s", "largest memory of a job, MB")
    return table(head, rows)


def slow(run):
    """Sentences on what the speed row does not reach, and on how it differs from the goal's."""
    out = []
    most = max((c.memory for c in run.costs.values()), default=0)
    solve = getattr(run.costs.get("solve"), "wall", np.nan)
    figures = (
        ("log to solution.json", run.wall, SPEED_GOALS["wall"], "s"),
        ("solve", solve, SPEED_GOALS["solve"], "s"),
        ("the largest job", most, SPEED_GOALS["memory"], "MB"),
        ("CPU time of decode over that of mcap's own reader", over_raw(run), RAW_GOAL, ""),
    )
    for what, got, goal, unit in figures:
        if not got <= goal:
            out.append(
                f"{what}: {digits(got)} {unit}".rstrip() + f", goal {goal:g} {unit}".rstrip()
            )
    return out


def missed(lines, run):
    """Everything that is not reached, one sentence each, as a Markdown list."""
    sentences = [s for line in lines for s in short_of(line)] + slow(run) + list(NOT_ESTIMATED)
    return "\n".join(f"* {s}." for s in sentences)


def pixels(lines):
    """The table of how far corners and contour points lie from the truth."""
    goals = {"diamond-camera": "0.005"}
    head = ("case", "N", "rms error per axis, px", "goal, px")
    found = [line for line in lines if line.method == DEFAULT and np.isfinite(line.pixels)]
    return table(
        head,
        [[x.row.title, str(x.n), digits(x.pixels), goals.get(x.row.key, "–")] for x in found],
    )


def memory(run):
    """A sentence on the memory of decode over the size of the log."""
    known = sorted(m for m in run.memory if np.isfinite(m[1]))
    if not known:
        return ""
    (small, at_small), (large, at_large) = known[0], known[-1]
    return (
        f"decode peaks at {at_small:.0f} MB on a log of {small:.0f} MB and at {at_large:.0f} MB "
        f"on one of {large:.0f} MB."
    )


def over_raw(run):
    """CPU time of decode over that of mcap's own reader."""
    return getattr(run.costs.get("decode"), "cpu", np.nan) / run.raw


def decoding(run):
    """A sentence on decode against mcap's own reader."""
    return (
        f"mcap's own reader takes {digits(run.raw)} s CPU to hand out the same messages undecoded; "
        f"decode, start of Python included, {digits(over_raw(run))} × that, goal {RAW_GOAL} ×."
    )


def whole(lines, run, quick, seeds):
    """The page; quick: only the smallest N; seeds: logs per line of a full run."""
    command = "make benchmark-quick" if quick else "make benchmark"
    parts = {
        "command": command,
        "machine": cost.machine(),
        "logs": "one log" if quick or seeds == 1 else f"{seeds} logs (`points`: one)",
        "accuracy": accuracy(lines),
        "missed": missed(lines, run),
        "pixels": pixels(lines),
        "about": run.about,
        "speed": speed(run),
        "wall": digits(run.wall),
        "decoding": decoding(run),
        "memory": memory(run),
        "ensemble": ENSEMBLE,
        "single": SINGLE,
    }
    return PAGE.format(**parts)


PAGE = """# Benchmark

`{command}` made this page from logs that `scripts/simulate.py` writes, {logs} per line: a VLP-16
at 10 Hz, a pinhole camera of 900 × 700 px, MCS at 100 Hz, a second at rest per placement. No job of
the pipeline sees the truth; extraction starts from a guess that is off by up to ±3 cm and ±5° per
axis. Everything but times and memory comes out the same again.

{machine}.

## Accuracy

![errors of all cases](benchmark.svg)

{accuracy}

* *error*: norm of the translation error and geodesic angle of the rotation error, root mean square
  over the logs; *σ reported*: the same from the covariance in calibration.json.
* *NEES/6*: mean of the squared error over the reported covariance, 1 where that is honest. Full
  statistics of it need a hundred draws or more and are not part of this run.
* *reference*: square root of the trace of the inverse information of the very data that `surface`
  used, at the truth and with the true noise: what an efficient estimator would reach.
* *goal*: where the lidar has noise, {ensemble} × the reference for the root mean square of many
  logs and {single} × for any single one. Only `surface`, the default, is held to the goals;
  `points` is the paper's way of comparing, with all returns or the board's corners as keypoints.
* *paper*: as claimed; *C++*: its published code, measured on logs of a like rig with other targets
  and poses, so that orders of magnitude compare. For the camera its saddle-point corners stand
  here; its OpenCV corners reach 0.015, 0.025 and 0.133 mm at N = 30, 15 and 5.

What a camera finds, against the truth:

{pixels}

## Cost

{about}, to extrinsics by default settings: {wall} s wall from the log to solution.json,
Snakemake's own start apart. The figures of a stage are of its jobs, start of Python included. CPU
times are the safer ones: wall times grow with whatever else the machine does meanwhile. The goal's
case is 2 lidars + 1 camera, 30 placements each, 1.7 GB.

{speed}

{decoding} {memory}

## Not reached

{missed}
"""
