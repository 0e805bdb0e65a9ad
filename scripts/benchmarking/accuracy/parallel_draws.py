"""All draws of a run of the benchmark, shared out among processes; the same for any number."""

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

N_DRAWS_PER_TASK = {"lidar": 20, "coverage": 50}  # draws of one task; of images, all of a recording


@dataclass(frozen=True)
class DrawTask:
    """Draws by seed of a row at N: of its source's folder of results, its log, and the settings of
    the run."""

    row_key: str
    n_placements: int
    results_folder: Path
    log_folder: Path
    settings: dict[str, Any]
    seeds: range

    def load_session(self) -> SimulatedSession:
        row = next(r for r in ACCURACY_ROWS if r.key == self.row_key)
        noise = LOG_ARGUMENTS[row.log_kind].split()
        return load_simulated_session(
            self.results_folder, self.log_folder, self.settings, row, noise
        )


def plan_draw_tasks(
    run: Path, logs: Path, settings: dict[str, Any], cases: list[AccuracyCase], max_draws: int
) -> list[DrawTask]:
    """The Tasks of all rows with noise among the cases, the longest first."""
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


def run_draw_task(task: DrawTask) -> tuple[list[DrawResult], tuple[np.ndarray, np.ndarray]]:
    """Draws of a Task, and the reference with and without outlines."""
    recording = task.load_session()
    return [redraw_and_estimate(recording, seed) for seed in task.seeds], compute_draw_references(
        recording
    )


def run_coverage_batch(case_title: str, seeds: Sequence[int]) -> list[DrawResult]:
    """Draws of one of coverage.CASES."""
    case = make_coverage_case(*COVERAGE_CASES[case_title])
    return [draw_coverage_error(case, seed) for seed in seeds]


def run_all_draws(
    tasks: list[DrawTask], n_coverage_draws: int, n_cores: int
) -> tuple[dict[tuple[str, int], DrawStatistics], list[CoverageResult]]:
    """({(row, N): Statistics}, [Coverage]): of all Tasks, and of `count` draws of each of
    coverage.CASES."""
    # Threads of NumPy's would take the cores from the other processes; they start with NumPy.
    os.environ["OMP_NUM_THREADS"] = "1"
    spans = [
        range(i, min(i + N_DRAWS_PER_TASK["coverage"], n_coverage_draws))
        for i in range(0, n_coverage_draws, N_DRAWS_PER_TASK["coverage"])
    ]
    with ProcessPoolExecutor(n_cores, get_context("spawn")) as pool:
        noisy = [(task, pool.submit(run_draw_task, task)) for task in tasks]
        ideal = {t: [pool.submit(run_coverage_batch, t, s) for s in spans] for t in COVERAGE_CASES}
        found: dict[tuple[str, int], list[Any]] = {}
        for task, future in noisy:
            found.setdefault((task.row_key, task.n_placements), []).append(future.result())
        covered = [
            compute_coverage(title, COVERAGE_CASES[title][1], [d for f in fs for d in f.result()])
            for title, fs in ideal.items()
        ]
    return {key: _merge_task_results(parts) for key, parts in found.items()}, covered


def _merge_task_results(parts: list[Any]) -> Any:
    reference, bare = parts[0][1]
    return compute_draw_statistics([d for part, _ in parts for d in part], reference, bare)
