"""Tables of noise draws, coverage and full runs as Markdown, and the goals that they miss."""

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

DRAW_COLUMNS = (
    "case",
    "N",
    "draws",
    "RMS error",
    "reference",
    "without outlines",
    "RMS / reference",
    "goal",
    "RMS / goal",
    f"above {MAX_SINGLE_RATIO:g} ×",
    "NEES/6 [band]",
    "of their mean",
    "95 % ellipsoids hold",
)
COVERAGE_COLUMNS = ("case", "draws", "sensor", "NEES over its degrees of freedom [band]", "held")
FULL_RUN_COLUMNS = ("sensor", "runs", "RMS error", "σ reported", "NEES/6 [band]", "held")


def order_by_row(
    draw_statistics: dict[tuple[str, int], DrawStatistics],
) -> list[tuple[AccuracyRow, int, DrawStatistics]]:
    """Return (row, number of placements, statistics) in the order of the rows.

    draw_statistics: by (row key, number of placements).
    """
    return [
        (row, n, draw_statistics[row.key, n])
        for row in ACCURACY_ROWS
        for n in row.placement_counts
        if (row.key, n) in draw_statistics
    ]


def format_draw_table(draw_statistics: dict[tuple[str, int], DrawStatistics]) -> str:
    """Return the table of noise draws, by (row key, number of placements)."""
    return format_markdown_table(
        DRAW_COLUMNS, [_format_draw_row(*item) for item in order_by_row(draw_statistics)]
    )


def _format_draw_row(row: AccuracyRow, n_placements: int, statistics: DrawStatistics) -> list[str]:
    goal = find_accuracy_goal(row, n_placements, statistics)
    return [
        row.title,
        str(n_placements),
        str(statistics.n_results)
        + (f" of {statistics.n_results + statistics.n_failures}" if statistics.n_failures else ""),
        format_mm_deg(statistics.rms_error),
        format_mm_deg(statistics.reference),
        format_mm_deg(statistics.reference_without_outlines),
        format_goal_ratio(statistics.rms_error, statistics.reference),
        format_mm_deg(goal),
        format_goal_ratio(statistics.rms_error, goal),
        f"{format_share_percent(statistics.outlier_share)} "
        f"({format_share_percent(statistics.gaussian_outlier_share)})",
        format_nees_band(statistics.mean_nees, statistics.n_results),
        format_two_digits(statistics.mean_error_nees),
        format_share_percent(statistics.share_covered),
    ]


def format_nees_band(nees: float, n_draws: int, n_dof: int = 6) -> str:
    """Return a mean NEES/n_dof and its band for a correct covariance as text."""
    low, high = compute_nees_band(n_draws, n_dof)
    return f"{format_two_digits(nees)} [{format_two_digits(low)}, {format_two_digits(high)}]"


def format_coverage_table(coverage_results: list[CoverageResult]) -> str:
    """Return the table of coverage results."""
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
    """Return the table of full runs, by sensor; their reference is the reported σ."""
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
    draw_statistics: dict[tuple[str, int], DrawStatistics],
    coverages: list[CoverageResult],
    run_statistics: dict[str, DrawStatistics],
) -> list[str]:
    """Return a sentence for each goal that the three tables miss."""
    out = [s for item in order_by_row(draw_statistics) for s in _check_row_goals(*item)]
    for c in coverages:
        for name, size in c.n_dof.items():
            label = f"observations as modelled, {c.title}, {name}"
            out += check_nees_band(label, c.mean_nees[name], c.n_draws, size)
            low, high = compute_coverage_band(c.n_draws)
            if not low <= c.share_covered[name] <= high:
                ends = f"{format_share_percent(low)} to {format_share_percent(high)}"
                out.append(
                    f"{label}: ellipsoids hold {format_share_percent(c.share_covered[name])}, "
                    f"goal {ends}"
                )
    for name, s in sorted(run_statistics.items()):
        label = f"full runs, {name}"
        out += describe_failed_draws(label, s) + check_nees_band(label, s.mean_nees, s.n_results)
    return out


def compute_coverage_band(n_draws: int) -> tuple[float, float]:
    """Return COVERAGE_GOAL, widened to the 95 % band of chance if there are few draws."""
    low, high = (
        binom.ppf(
            [(1 - CONFIDENCE_LEVEL) / 2, (1 + CONFIDENCE_LEVEL) / 2], n_draws, CONFIDENCE_LEVEL
        )
        / n_draws
    )
    return min(COVERAGE_GOAL[0], low), max(COVERAGE_GOAL[1], high)


def _check_row_goals(row: AccuracyRow, n_placements: int, statistics: DrawStatistics) -> list[str]:
    label = f"{row.title}, N = {n_placements}, {statistics.n_results} draws"
    goal_note = "" if row.goals else f" ({MAX_RMS_RATIO} × the reference)"
    out = describe_failed_draws(label, statistics) + check_error_goal(
        label, statistics.rms_error, find_accuracy_goal(row, n_placements, statistics), goal_note
    )
    if row.goals is None and statistics.outlier_share > 0:
        out.append(
            f"{label}: {format_share_percent(statistics.outlier_share)} of the draws err by more "
            f"than {MAX_SINGLE_RATIO:g} × the reference, the worst by "
            f"{format_two_digits(statistics.worst_error_ratio)} ×; with an efficient estimator "
            f"{format_share_percent(statistics.gaussian_outlier_share)}"
        )
    return out + check_nees_band(label, statistics.mean_nees, statistics.n_results)


def describe_failed_draws(case_label: str, statistics: DrawStatistics) -> list[str]:
    """Return a sentence on the number of draws without a pose, if there are any."""
    return (
        [
            f"{case_label}: {statistics.n_failures} of "
            f"{statistics.n_results + statistics.n_failures}"
            " without a pose"
        ]
        if statistics.n_failures
        else []
    )


def check_nees_band(case_label: str, nees: float, n_draws: int, n_dof: int = 6) -> list[str]:
    """Return a sentence on a NEES outside its band, if it is."""
    low, high = compute_nees_band(n_draws, n_dof)
    if low <= nees <= high:
        return []
    ends = f"{format_two_digits(low)} to {format_two_digits(high)}"
    return [
        f"{case_label}: NEES over its degrees of freedom is {format_two_digits(nees)}, "
        f"with a correct σ {ends}"
    ]
