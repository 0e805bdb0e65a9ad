"""Run all draws of the benchmark in parallel; results do not depend on the number of processes."""

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarking.accuracy.accuracy_cases import (
    ACCURACY_ROWS,
    LOG_ARGUMENTS,
    AccuracyCase,
    find_draw_source,
)
from benchmarking.accuracy.covariance_coverage import (
    COVERAGE_CASES,
    CoverageResult,
    compute_coverage,
    draw_coverage_error,
    make_coverage_case,
)
from benchmarking.accuracy.draw_statistics import (
    DrawResult,
    DrawStatistics,
    compute_draw_statistics,
)
from benchmarking.accuracy.noise_draws import compute_draw_references, redraw_and_estimate
from benchmarking.accuracy.simulated_session import SimulatedSession, load_simulated_session
from benchmarking.accuracy.simulation_plan import case_folder, simulated_log_name

N_DRAWS_PER_TASK = {"lidar": 20, "coverage": 50}  # camera: all draws of a recording
# Draws, and the reference covariances (6, 6) with and without outlines.
DrawTaskResult = tuple[list[DrawResult], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class DrawTask:
    """Some draws, by seed, of one row at one number of placements.

    results_folder, log_folder: of the source recording; settings: complete config of the run.
    """

    row_key: str
    n_placements: int
    results_folder: Path
    log_folder: Path
    settings: dict[str, Any]
    seeds: range

    def load_session(self) -> SimulatedSession:
        """Load the source recording."""
        row = next(r for r in ACCURACY_ROWS if r.key == self.row_key)
        noise = LOG_ARGUMENTS[row.log_kind].split()
        return load_simulated_session(
            self.results_folder, self.log_folder, self.settings, row, noise
        )


def plan_draw_tasks(
    run: Path, logs: Path, settings: dict[str, Any], cases: list[AccuracyCase], max_draws: int
) -> list[DrawTask]:
    """Return the tasks of all rows with noise in cases, most placements first."""
    out = []
    counts = {(c.row.key, c.n_placements) for c in cases}
    for row_key, n in sorted(counts, key=lambda k: (-k[1], k[0])):
        row = next(r for r in ACCURACY_ROWS if r.key == row_key)
        source = find_draw_source(row, n)
        if source is None:
            continue
        results = run / case_folder(source) / "results" / source.case_name / source.case_name
        count = row.count_draws(n, max_draws)
        size = count if row.is_camera else N_DRAWS_PER_TASK["lidar"]
        log = logs / simulated_log_name(*source.log_key)
        for first in range(0, count, size):
            seeds = range(first, min(first + size, count))
            out.append(DrawTask(row.key, n, results, log, settings, seeds))
    return out


def run_draw_task(task: DrawTask) -> DrawTaskResult:
    """Return the draws of a task, and the reference covariances with and without outlines."""
    session = task.load_session()
    draws = [redraw_and_estimate(session, seed) for seed in task.seeds]
    return draws, compute_draw_references(session)


def run_coverage_batch(case_title: str, seeds: Sequence[int]) -> list[DrawResult]:
    """Return the draws of one of COVERAGE_CASES."""
    case = make_coverage_case(*COVERAGE_CASES[case_title])
    return [draw_coverage_error(case, seed) for seed in seeds]


def run_all_draws(
    tasks: list[DrawTask], n_coverage_draws: int, n_cores: int
) -> tuple[dict[tuple[str, int], DrawStatistics], list[CoverageResult]]:
    """Return the statistics by (row key, number of placements), and the coverage results.

    n_coverage_draws: draws of each of COVERAGE_CASES.
    """
    # One thread per process. NumPy reads this when it is imported, so before the workers start.
    os.environ["OMP_NUM_THREADS"] = "1"
    spans = [
        range(i, min(i + N_DRAWS_PER_TASK["coverage"], n_coverage_draws))
        for i in range(0, n_coverage_draws, N_DRAWS_PER_TASK["coverage"])
    ]
    with ProcessPoolExecutor(n_cores, get_context("spawn")) as pool:
        noise_futures = [(task, pool.submit(run_draw_task, task)) for task in tasks]
        coverage_futures = {
            t: [pool.submit(run_coverage_batch, t, s) for s in spans] for t in COVERAGE_CASES
        }
        draw_parts: dict[tuple[str, int], list[DrawTaskResult]] = {}
        for task, future in noise_futures:
            draw_parts.setdefault((task.row_key, task.n_placements), []).append(future.result())
        covered = [
            compute_coverage(title, COVERAGE_CASES[title][1], [d for f in fs for d in f.result()])
            for title, fs in coverage_futures.items()
        ]
    return {key: _merge_task_results(parts) for key, parts in draw_parts.items()}, covered


def _merge_task_results(parts: list[DrawTaskResult]) -> DrawStatistics:
    reference, without_outlines = parts[0][1]
    draws = [draw for part, _ in parts for draw in part]
    return compute_draw_statistics(draws, reference, without_outlines)
