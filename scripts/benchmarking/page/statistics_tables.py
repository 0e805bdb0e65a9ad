"""Tables of many draws, of coverage and of full runs, and what they fall short of, as Markdown."""

from typing import Any

from numpy import float64
from scipy.stats import binom

from benchmarking.accuracy.accuracy_cases import (
    ACCURACY_ROWS,
    COVERAGE_GOAL,
    MAX_RMS_RATIO,
    MAX_SINGLE_RATIO,
    AccuracyRow,
)
from benchmarking.accuracy.covariance_coverage import CoverageResult
from benchmarking.accuracy.draw_statistics import (
    CONFIDENCE_LEVEL,
    DrawStatistics,
    compute_nees_band,
)
from benchmarking.accuracy.error_metrics import find_accuracy_goal
from benchmarking.page.markdown import (
    check_error_goal,
    format_goal_ratio,
    format_markdown_table,
    format_mm_deg,
    format_share_percent,
    format_two_digits,
)

DRAW_COLUMNS: tuple[str, ...] = (
    "case",
    "N",
    "draws",
    "RMS error",
    "reference",
    "without outlines",
    "RMS / reference",
)
DRAW_COLUMNS += (
    "goal",
    "RMS / goal",
    f"above {MAX_SINGLE_RATIO:g} ×",
    "NEES/6 [band]",
    "of their mean",
)
DRAW_COLUMNS += ("95 % ellipsoids hold",)
COVERAGE_COLUMNS = ("case", "draws", "sensor", "NEES over its degrees of freedom [band]", "held")
FULL_RUN_COLUMNS = ("sensor", "runs", "RMS error", "σ reported", "NEES/6 [band]", "held")


def order_by_row(
    draw_statistics: dict[tuple[str, int], DrawStatistics],
) -> list[tuple[AccuracyRow, int, DrawStatistics]]:
    """[(row, N, Statistics)] of {(key, N): Statistics}, in the order of the rows."""
    return [
        (row, n, draw_statistics[row.key, n])
        for row in ACCURACY_ROWS
        for n in row.placement_counts
        if (row.key, n) in draw_statistics
    ]


def format_draw_table(draw_statistics: dict[tuple[str, int], DrawStatistics]) -> str:
    """The table of {(key, N): Statistics}."""
    return format_markdown_table(
        DRAW_COLUMNS, [_format_draw_row(*item) for item in order_by_row(draw_statistics)]
    )


def _format_draw_row(row: AccuracyRow, n_placements: int, statistics: DrawStatistics) -> list[str]:
    most = find_accuracy_goal(row, n_placements, statistics)
    return [
        row.title,
        str(n_placements),
        str(statistics.n_results)
        + (f" of {statistics.n_results + statistics.n_failures}" if statistics.n_failures else ""),
        format_mm_deg(statistics.rms_error),
        format_mm_deg(statistics.reference),
        format_mm_deg(statistics.reference_without_outlines),
        format_goal_ratio(statistics.rms_error, statistics.reference),
        format_mm_deg(most),
        format_goal_ratio(statistics.rms_error, most),
        f"{format_share_percent(statistics.outlier_share)} "
        f"({format_share_percent(statistics.gaussian_outlier_share)})",
        format_nees_band(statistics.mean_nees, statistics.n_results),
        format_two_digits(statistics.mean_error_nees),
        format_share_percent(statistics.share_covered),
    ]


def format_nees_band(nees: float, n_draws: int, n_dof: int = 6) -> str:
    """A mean of NEES over its degrees of freedom, with the band of honest ones, as text."""
    low, high = compute_nees_band(n_draws, n_dof)
    return f"{format_two_digits(nees)} [{format_two_digits(low)}, {format_two_digits(high)}]"


def format_coverage_table(coverage_results: list[CoverageResult]) -> str:
    """The table of Coverages."""
    return format_markdown_table(
        COVERAGE_COLUMNS,
        [
            [
                c.title,
                str(c.n_draws),
                name,
                format_nees_band(c.mean_nees[name], c.n_draws, size),
                format_share_percent(c.share_covered[name]),
            ]
            for c in coverage_results
            for name, size in c.n_dof.items()
        ],
    )


def format_full_run_table(run_statistics: dict[str, DrawStatistics]) -> str:
    """The table of {sensor: Statistics} of full runs, whose reference is σ as reported."""
    return format_markdown_table(
        FULL_RUN_COLUMNS,
        [
            [
                name,
                str(s.n_results),
                format_mm_deg(s.rms_error),
                format_mm_deg(s.reference),
                format_nees_band(s.mean_nees, s.n_results),
            ]
            + [format_share_percent(s.share_covered)]
            for name, s in sorted(run_statistics.items())
        ],
    )


def check_draw_goals(
    draw_statistics: dict[Any, Any], coverages: list[CoverageResult], run_statistics: dict[Any, Any]
) -> list[str | Any]:
    """Sentences on what the three tables do not reach."""
    out = [s for item in order_by_row(draw_statistics) for s in _check_row_goals(*item)]
    for c in coverages:
        for name, size in c.n_dof.items():
            where = f"observations as modelled, {c.title}, {name}"
            out += check_nees_band(where, c.mean_nees[name], c.n_draws, size)
            low, high = compute_coverage_band(c.n_draws)
            if not low <= c.share_covered[name] <= high:
                ends = f"{format_share_percent(low)} to {format_share_percent(high)}"
                out.append(
                    f"{where}: ellipsoids hold {format_share_percent(c.share_covered[name])}, "
                    f"goal {ends}"
                )
    for name, s in sorted(run_statistics.items()):
        where = f"full runs, {name}"
        out += describe_failed_draws(where, s) + check_nees_band(where, s.mean_nees, s.n_results)
    return out


def compute_coverage_band(n_draws: int) -> tuple[float64, float64] | tuple[float, float]:
    """HELD, or where that is wider, as with few draws, what chance does to an honest share."""
    low, high = (
        binom.ppf(
            [(1 - CONFIDENCE_LEVEL) / 2, (1 + CONFIDENCE_LEVEL) / 2], n_draws, CONFIDENCE_LEVEL
        )
        / n_draws
    )
    return min(COVERAGE_GOAL[0], low), max(COVERAGE_GOAL[1], high)


def _check_row_goals(row: AccuracyRow, n_placements: int, statistics: DrawStatistics) -> list[str]:
    where = f"{row.title}, N = {n_placements}, {statistics.n_results} draws"
    own = "" if row.goals else f" ({MAX_RMS_RATIO} × the reference)"
    out = describe_failed_draws(where, statistics) + check_error_goal(
        where, statistics.rms_error, find_accuracy_goal(row, n_placements, statistics), own
    )
    if row.goals is None and statistics.outlier_share > 0:
        out.append(
            f"{where}: {format_share_percent(statistics.outlier_share)} err by more than "
            f"{MAX_SINGLE_RATIO:g} × the reference, one by "
            f"{format_two_digits(statistics.worst_error_ratio)} ×; of an efficient estimator "
            f"{format_share_percent(statistics.gaussian_outlier_share)} would"
        )
    return out + check_nees_band(where, statistics.mean_nees, statistics.n_results)


def describe_failed_draws(case_label: str, statistics: DrawStatistics) -> list[str]:
    """A sentence on draws without a pose, if there are any."""
    return (
        [
            f"{case_label}: {statistics.n_failures} of "
            f"{statistics.n_results + statistics.n_failures}"
            " without a pose"
        ]
        if statistics.n_failures
        else []
    )


def check_nees_band(case_label: str, nees: float, n_draws: int, n_dof: int = 6) -> list[str | Any]:
    """A sentence on a NEES outside its band, if it is."""
    low, high = compute_nees_band(n_draws, n_dof)
    if low <= nees <= high:
        return []
    ends = f"{format_two_digits(low)} to {format_two_digits(high)}"
    return [
        f"{case_label}: NEES over its degrees of freedom is {format_two_digits(nees)}, "
        f"of an honest σ {ends}"
    ]
