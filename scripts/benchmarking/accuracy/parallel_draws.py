"""All draws of a run of the benchmark, shared out among processes; the same for any number."""

import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

from benchmarking.accuracy import (
    accuracy_cases,
    covariance_coverage,
    draw_statistics,
    noise_draws,
    simulated_session,
    simulation_plan,
)

CHUNK = {"lidar": 20, "coverage": 50}  # draws of one task; of images, all of a recording


@dataclass(frozen=True)
class Task:
    """Draws by seed of a row at N: of its source's folder of results, its log, and the settings of
    the run."""

    row: str
    n: int
    results: object
    log: object
    settings: dict
    seeds: range

    def recording(self):
        row = next(r for r in accuracy_cases.ROWS if r.key == self.row)
        noise = accuracy_cases.LOGS[row.log].split()
        return simulated_session.recording(self.results, self.log, self.settings, row, noise)


def tasks(run, logs, settings, cases, most):
    """The Tasks of all rows with noise among the cases, the longest first."""
    out = []
    for row, n in sorted({(c.row.key, c.n) for c in cases}, key=lambda k: (-k[1], k[0])):
        row = next(r for r in accuracy_cases.ROWS if r.key == row)
        source = accuracy_cases.source(row, n)
        if source is None:
            continue
        results = run / simulation_plan.home(source) / "results" / source.name / source.name
        count = row.draws(n, most)
        size = count if row.of_images else CHUNK["lidar"]
        log = logs / simulation_plan.log_name(*source.log)
        for first in range(0, count, size):
            seeds = range(first, min(first + size, count))
            out.append(Task(row.key, n, results, log, settings, seeds))
    return out


def drawn(task):
    """Draws of a Task, and the reference with and without outlines."""
    recording = task.recording()
    return [noise_draws.draw(recording, seed) for seed in task.seeds], noise_draws.limits(recording)


def observed(title, seeds):
    """Draws of one of coverage.CASES."""
    case = covariance_coverage.geometry_of(*covariance_coverage.CASES[title])
    return [covariance_coverage.draw(case, seed) for seed in seeds]


def everything(pending, count, cores):
    """({(row, N): Statistics}, [Coverage]): of all Tasks, and of `count` draws of each of
    coverage.CASES."""
    # Threads of NumPy's would take the cores from the other processes; they start with NumPy.
    os.environ["OMP_NUM_THREADS"] = "1"
    spans = [
        range(i, min(i + CHUNK["coverage"], count)) for i in range(0, count, CHUNK["coverage"])
    ]
    with ProcessPoolExecutor(cores, get_context("spawn")) as pool:
        noisy = [(task, pool.submit(drawn, task)) for task in pending]
        ideal = {t: [pool.submit(observed, t, s) for s in spans] for t in covariance_coverage.CASES}
        found = {}
        for task, future in noisy:
            found.setdefault((task.row, task.n), []).append(future.result())
        covered = [
            covariance_coverage.coverage(
                title, covariance_coverage.CASES[title][1], [d for f in fs for d in f.result()]
            )
            for title, fs in ideal.items()
        ]
    return {key: _statistics(parts) for key, parts in found.items()}, covered


def _statistics(parts):
    reference, bare = parts[0][1]
    return draw_statistics.statistics([d for part, _ in parts for d in part], reference, bare)
