"""Render docs/benchmark.md: the tables of the benchmark and the goals that it misses."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarking.accuracy.accuracy_cases import (
    COVERAGE_GOAL,
    DEFAULT_METHOD,
    MAX_RMS_RATIO,
    MAX_SINGLE_RATIO,
    UNMEASURED_GOALS,
)
from benchmarking.accuracy.covariance_coverage import CoverageResult
from benchmarking.accuracy.draw_statistics import DrawStatistics
from benchmarking.accuracy.error_metrics import AccuracyLine, find_accuracy_goal
from benchmarking.decode_cost.process_cost import RunSpeed, describe_machine
from benchmarking.page.markdown import (
    PageSection,
    check_error_goal,
    format_goal_ratio,
    format_markdown_table,
    format_mm_deg,
    format_two_digits,
    render_markdown,
)
from benchmarking.page.statistics_tables import (
    check_draw_goals,
    format_coverage_table,
    format_draw_table,
    format_full_run_table,
)

# Statistics by (row key, number of placements), coverage results, full runs by sensor.
DrawResults = tuple[
    dict[tuple[str, int], DrawStatistics], list[CoverageResult], dict[str, DrawStatistics]
]
PAGE_TEMPLATE = Path(__file__).with_suffix(".md.j2")
ACCURACY_COLUMNS = (
    "case",
    "N",
    "method",
    "error",
    "σ reported",
    "reference",
    "goal",
    "error / goal",
    "paper",
    "C++",
)
SPEED_GOALS = {"wall": 14.0, "solve": 1.0, "memory": 600}  # s, s, MB
MAX_CPU_RATIO = 1.5  # goal: CPU time of decode over that of mcap's own reader


def format_accuracy_table(lines: list[AccuracyLine]) -> str:
    """Return the accuracy table."""
    return format_markdown_table(ACCURACY_COLUMNS, [format_accuracy_row(line) for line in lines])


def format_accuracy_row(line: AccuracyLine) -> list[str]:
    """Return the cells of one line of the accuracy table."""
    row, has_goal = line.row, line.method == DEFAULT_METHOD and line.row.is_noise_free
    goal = find_accuracy_goal(row, line.n_placements, line) if has_goal else None
    return [
        row.title,
        str(line.n_placements),
        line.method,
        format_mm_deg(line.error),
        format_mm_deg(line.sigma),
        "no noise" if row.is_noise_free else format_mm_deg(line.reference),
        format_mm_deg(goal),
        format_goal_ratio(line.error, goal) if goal else "–",
        format_mm_deg(row.paper_errors.get(line.n_placements)),
        format_mm_deg(row.cpp_errors.get(line.method, {}).get(line.n_placements)),
    ]


def check_line_goals(line: AccuracyLine) -> list[str]:
    """Return a sentence for each goal that a line misses.

    Only the default method has goals, and for a single log only if its data have no noise.
    """
    if line.method != DEFAULT_METHOD:
        return []
    label = f"{line.row.title}, N = {line.n_placements}"
    out = [f"{label}: a log without a pose: {reason}" for reason in line.failure_reasons]
    if line.row.is_noise_free and line.n_logs:
        out += check_error_goal(
            label, line.error, find_accuracy_goal(line.row, line.n_placements, line)
        )
    return out


def format_cost_table(run_speed: RunSpeed) -> str:
    """Return the cost table: one row per stage and one for all."""
    rows = [
        [stage, str(c.n_jobs), f"{c.wall_s:.1f}", f"{c.cpu_s:.1f}", str(c.peak_memory_mb)]
        for stage, c in run_speed.stage_costs.items()
    ]
    sums = [
        sum(getattr(c, k) for c in run_speed.stage_costs.values())
        for k in ("n_jobs", "wall_s", "cpu_s")
    ]
    most = str(max((c.peak_memory_mb for c in run_speed.stage_costs.values()), default=0))
    rows.append(["all", str(sums[0]), f"{sums[1]:.1f}", f"{sums[2]:.1f}", most])
    head = ("stage", "jobs", "wall, s", "CPU, s", "largest memory of a job, MB")
    return format_markdown_table(head, rows)


def check_speed_goals(run_speed: RunSpeed) -> list[str]:
    """Return a sentence for each speed or memory goal that a run misses."""
    out = []
    peak_memory = max((c.peak_memory_mb for c in run_speed.stage_costs.values()), default=0)
    solve = getattr(run_speed.stage_costs.get("solve"), "wall_s", np.nan)
    figures = (
        ("log to solution.json", run_speed.wall_s, SPEED_GOALS["wall"], "s"),
        ("solve", solve, SPEED_GOALS["solve"], "s"),
        ("the largest job", peak_memory, SPEED_GOALS["memory"], "MB"),
        (
            "CPU time of decode over that of mcap's own reader",
            decode_cpu_ratio(run_speed),
            MAX_CPU_RATIO,
            "",
        ),
    )
    for name, value, goal, unit in figures:
        if not value <= goal:
            out.append(
                f"{name}: {format_two_digits(value)} {unit}".rstrip()
                + f", goal {goal:g} {unit}".rstrip()
            )
    return out


def format_missed_goals(
    lines: list[AccuracyLine],
    run_speed: RunSpeed,
    draw_results: DrawResults,
    sections: Sequence[PageSection],
) -> str:
    """Return all missed goals as a Markdown list.

    draw_results: (noise draws, coverage, full runs), as for check_draw_goals.
    """
    sentences = [s for line in lines for s in check_line_goals(line)] + check_draw_goals(
        *draw_results
    )
    sentences += check_speed_goals(run_speed) + [
        s for section in sections for s in section.missed_goals
    ]
    sentences += list(UNMEASURED_GOALS)
    return "\n".join(f"* {s}." for s in sentences)


def format_pixel_table(lines: list[AccuracyLine]) -> str:
    """Return the table of the errors of corners and contour points."""
    goals = {"diamond-camera": "0.005"}
    head = ("case", "N", "rms error per axis, px", "goal, px")
    measured = [
        line for line in lines if line.method == DEFAULT_METHOD and np.isfinite(line.pixel_error_px)
    ]
    return format_markdown_table(
        head,
        [
            [
                x.row.title,
                str(x.n_placements),
                format_two_digits(x.pixel_error_px),
                goals.get(x.row.key, "–"),
            ]
            for x in measured
        ],
    )


def describe_decode_memory(run_speed: RunSpeed) -> str:
    """Return a sentence on the memory of decode for the smallest and the largest log."""
    measured = sorted(m for m in run_speed.decode_memory_mb if np.isfinite(m[1]))
    if not measured:
        return ""
    (small, at_small), (large, at_large) = measured[0], measured[-1]
    return (
        f"decode peaks at {at_small:.0f} MB on a log of {small:.0f} MB and at {at_large:.0f} MB "
        f"on one of {large:.0f} MB."
    )


def decode_cpu_ratio(run_speed: RunSpeed) -> float:
    """Return the CPU time of decode over that of mcap's own reader."""
    return getattr(run_speed.stage_costs.get("decode"), "cpu_s", np.nan) / run_speed.raw_cpu_s


def describe_decode_cost(run_speed: RunSpeed) -> str:
    """Return a sentence that compares decode with mcap's own reader."""
    return (
        f"mcap's own reader takes {format_two_digits(run_speed.raw_cpu_s)} s CPU to read the same "
        "messages without decoding them. decode, with the start of Python, takes "
        f"{format_two_digits(decode_cpu_ratio(run_speed))} × that, goal {MAX_CPU_RATIO} ×."
    )


def render_benchmark_page(
    lines: list[AccuracyLine],
    run_speed: RunSpeed,
    draw_results: DrawResults,
    sections: Sequence[PageSection],
    is_quick: bool,
) -> str:
    """Return the page as Markdown.

    sections: further sections after the cost; is_quick: whether only the smallest N was measured.
    """
    parts = {
        "command": "make benchmark-quick" if is_quick else "make benchmark",
        "machine": describe_machine(),
        "accuracy": format_accuracy_table(lines),
        "drawn": format_draw_table(draw_results[0]),
        "covered": format_coverage_table(draw_results[1]),
        "full": format_full_run_table(draw_results[2]),
        "held": " to ".join(f"{100 * h:g}" for h in COVERAGE_GOAL),
        "missed": format_missed_goals(lines, run_speed, draw_results, sections),
        "sections": "\n\n".join(f"## {s.title}\n\n{s.text}" for s in sections),
        "pixels": format_pixel_table(lines),
        "about": run_speed.description,
        "speed": format_cost_table(run_speed),
        "wall": format_two_digits(run_speed.wall_s),
        "decoding": describe_decode_cost(run_speed),
        "memory": describe_decode_memory(run_speed),
        "ensemble": MAX_RMS_RATIO,
        "single": MAX_SINGLE_RATIO,
    }
    return render_markdown(PAGE_TEMPLATE, **parts)
