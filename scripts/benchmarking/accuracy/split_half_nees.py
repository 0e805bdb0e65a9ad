"""Split halves of a run: are its σ true? Draws halves of the keypoints of every rig of a folder.

Run    PYTHONPATH=scripts python -m benchmarking.accuracy.split_half_nees FOLDER... [--draws 30]
Needs  folders with a finished run; prints a table as in docs/benchmark.md
"""

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import solve
from benchmarking.page.markdown import (
    PageSection,
    format_markdown_table,
    format_two_digits,
    render_markdown,
)
from calib.diagnosis.correction_selection import select_confirmed_corrections
from calib.diagnosis.covariance.choice_covariance import choice_covariance
from calib.diagnosis.error_search.supported_corrections import with_requested_corrections
from calib.diagnosis.split_halves import HalfEstimate, compare_halves, estimate_halves
from calib.estimation.problem_assembly import iteration_limits

ROOT = Path(__file__).parents[3]
PAGE_TEMPLATE = Path(__file__).with_suffix(".md.j2")
NEES_GOAL = (0.5, 1.5)  # of the mean over the halvings of a recording
COLUMNS = (
    "recording", "sensor", "halves", "NEES, model alone", "NEES, with placements", "NEES, reported",
    "median", "chose alike",
)  # fmt: skip


@dataclass(frozen=True)
class SplitHalfDraw:
    """One halving: NEES over its directions of one sensor.

    model: by the model's covariance; clusters: with what placements scatter by; reported: with what
    the choice of corrections moves; is_same_choice: whether both halves chose alike.
    """

    sensor: str
    model: float
    clusters: float
    reported: float
    is_same_choice: bool


def list_solve_arguments(folder: Path) -> Iterator[list[str]]:
    """Yield the arguments of the solve job of every rig of a folder."""
    snakemake = Path(sys.executable).with_name("snakemake")
    command = [str(snakemake), "-s", str(ROOT / "Snakefile"), "-d", str(folder), "--cores", "1"]
    command += ["-n", "-F", "--printshellcmds", "--quiet", "host"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    for line in re.findall(r"^Shell command: (.*solve\.py .*)$", run.stdout + run.stderr, re.M):
        yield shlex.split(line.rsplit(" 2> ", 1)[0])[2:]


def draw_split_halves(arguments: Sequence[str], n_draws: int) -> list[SplitHalfDraw]:
    """Draw halves of the placements of one rig."""
    args = solve.parse_arguments(arguments)
    options: dict[str, Any] = args.options
    setup, start, _ = solve.build_rig_setup(args, options)
    limits, wanted = iteration_limits(setup, options["solve"]), options["solve"]["estimate"]
    requested, out = with_requested_corrections(setup, wanted), []
    for seed in range(n_draws):
        halves = estimate_halves(setup, start, wanted, seed=seed, **limits)
        if halves is None:
            continue
        whole = select_confirmed_corrections(setup, start, wanted, halves, **limits)[:2]
        added = choice_covariance(requested, whole, halves, **limits)
        for i, sensor in enumerate(sorted(whole[0].models)):
            block = added[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
            out += _compare(halves, sensor, block)
    return out


def _compare(
    halves: tuple[HalfEstimate, HalfEstimate], sensor: str, added: np.ndarray
) -> list[SplitHalfDraw]:
    model, clusters, reported = (
        compare_halves(pair, sensor, block)
        for pair, block in (
            ((_by_model(halves[0]), _by_model(halves[1])), None),
            (halves, None),
            (halves, added),
        )
    )
    if model is None or clusters is None or reported is None:
        return []
    a, b, c = (found.nees / found.n_directions for found in (model, clusters, reported))
    is_same_choice = halves[0].adopted == halves[1].adopted
    return [SplitHalfDraw(sensor, a, b, c, is_same_choice)]


def _by_model(half: HalfEstimate) -> HalfEstimate:
    """Return the half with the covariance of its model alone."""
    solved = replace(half.result.solved, added_pose_covariance=None)
    return replace(half, result=replace(half.result, solve_result=solved))


def format_split_half_table(draws_by_title: dict[str, list[SplitHalfDraw]]) -> str:
    """Return the table of NEES over degrees of freedom, by recording and sensor."""
    rows = []
    for title, draws in draws_by_title.items():
        for sensor in sorted({d.sensor for d in draws}):
            own = [d for d in draws if d.sensor == sensor]
            rows.append([title, sensor, str(len(own)), *_format_sensor_cells(own)])
    return format_markdown_table(COLUMNS, rows)


def _format_sensor_cells(draws: list[SplitHalfDraw]) -> list[str]:
    means = [np.mean([getattr(d, k) for d in draws]) for k in ("model", "clusters", "reported")]
    median = np.median([d.reported for d in draws])
    alike = sum(d.is_same_choice for d in draws)
    return [*(format_two_digits(float(v)) for v in (*means, median)), f"{alike} of {len(draws)}"]


def measure_split_halves(
    folders: Sequence[Path], n_draws: int, estimate_options: dict[str, Any] | None = None
) -> dict[str, list[SplitHalfDraw]]:
    """Draw halves of every rig of the folders of finished runs; return the draws by title.

    estimate_options: keys of solve.estimate to set instead.
    """
    out, here = {}, Path.cwd()
    for folder in (f.resolve() for f in folders):
        for words in list_solve_arguments(folder):
            at = words.index("--options") + 1
            options = json.loads(words[at])
            options["solve"]["estimate"] |= estimate_options or {}
            words[at] = json.dumps(options)
            os.chdir(folder)  # the paths of a job are relative to its folder
            try:
                out[f"{folder.name}, {options['rig']}"] = draw_split_halves(words, n_draws)
            finally:
                os.chdir(here)
    return out


def build_split_half_section(draws_by_title: dict[str, list[SplitHalfDraw]]) -> PageSection:
    """Return the section of the page on split halves."""
    table = format_split_half_table(draws_by_title)
    text = render_markdown(PAGE_TEMPLATE, table=table, low=NEES_GOAL[0], high=NEES_GOAL[1])
    return PageSection("Split halves", text, check_split_half_goals(draws_by_title))


def check_split_half_goals(draws_by_title: dict[str, list[SplitHalfDraw]]) -> list[str]:
    """Return a sentence for each sensor whose mean NEES misses the goal."""
    out = []
    for title, draws in draws_by_title.items():
        for sensor in sorted({d.sensor for d in draws}):
            mean = float(np.mean([d.reported for d in draws if d.sensor == sensor]))
            if not NEES_GOAL[0] <= mean <= NEES_GOAL[1]:
                goal = f"{NEES_GOAL[0]:g} to {NEES_GOAL[1]:g}"
                out.append(f"split halves of {title}: {sensor} has {mean:.2g}, goal {goal}")
    return out


def main(argv: Sequence[str] | None = None) -> None:
    """Draw halves of every rig of every folder, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path, help="folders of finished runs")
    parser.add_argument("--draws", type=int, default=30, help="halvings of each rig")
    parser.add_argument("--estimate", default="{}", help="solve.estimate to set instead, as JSON")
    args = parser.parse_args(argv)
    draws_by_title = measure_split_halves(args.folders, args.draws, json.loads(args.estimate))
    print(format_split_half_table(draws_by_title))


if __name__ == "__main__":
    main()
