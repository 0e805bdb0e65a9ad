"""The chart of the benchmark: measured errors, goals and published errors."""

import io

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarking.accuracy.accuracy_cases import DEFAULT_METHOD
from benchmarking.accuracy.draw_statistics import DrawStatistics
from benchmarking.accuracy.error_metrics import AccuracyLine, find_accuracy_goal

FIGURE_SIZE_INCH = (9.0, 6.4)  # inch
CHART_MARKERS = {  # marker, colour, size
    "surface": ("o", "#1f6fd6", 38),
    "points": ("s", "#d9820f", 26),
    "points, corners": ("^", "#1f9d63", 28),
    "goal": ("|", "#222222", 110),
    "paper": ("x", "#8a8f98", 28),
    "C++ points": ("D", "#c9a0ee", 18),
    "C++ points, corners": ("v", "#8f4fc4", 24),
    "C++": ("D", "#c9a0ee", 18),
}
MIN_DRAWN_ERROR = (1e-6, 1e-7)  # mm, deg: smaller errors are drawn at the edge


def collect_chart_marks(
    line: AccuracyLine, draw_statistics: dict[tuple[str, int], DrawStatistics]
) -> dict[str, tuple[float, float]]:
    """Return the marks of one line of the table, (mm, deg) by key of CHART_MARKERS.

    draw_statistics: by (row key, number of placements); where there are any, their RMS error
    replaces the error of the single log.
    """
    out: dict[str, tuple[float, float] | None] = {line.method: line.error}
    if line.method == DEFAULT_METHOD:
        many = draw_statistics.get((line.row.key, line.n_placements))
        out["goal"] = find_accuracy_goal(line.row, line.n_placements, many or line)
        out[DEFAULT_METHOD] = many.rms_error if many else line.error
        out["paper"] = line.row.paper_errors.get(line.n_placements)
    cpp = line.row.cpp_errors.get(line.method, {}).get(line.n_placements)
    out["C++" if line.method == DEFAULT_METHOD else f"C++ {line.method}"] = cpp
    return {k: v for k, v in out.items() if v is not None and np.all(np.isfinite(v))}


def draw_error_chart(
    lines: list[AccuracyLine], draw_statistics: dict[tuple[str, int], DrawStatistics]
) -> Figure:
    """Draw mm on the left and degrees on the right, one row per case and number of placements."""
    matplotlib.rcdefaults()
    matplotlib.rcParams.update({"svg.fonttype": "none", "font.size": 8})
    rows = list(dict.fromkeys((line.row.key, line.n_placements) for line in lines))
    fig = Figure(FIGURE_SIZE_INCH, facecolor="white")
    axes = fig.subplots(1, 2, sharey=True)
    for i, (ax, unit) in enumerate(zip(axes, ("mm", "deg"), strict=True)):
        for line in lines:
            for mark, value in collect_chart_marks(line, draw_statistics).items():
                marker, color, size = CHART_MARKERS[mark]
                y = rows.index((line.row.key, line.n_placements))
                x = max(value[i], MIN_DRAWN_ERROR[i])
                ax.scatter(x, y, size, color, marker=marker, linewidths=1.4, zorder=3)
        ax.set(xscale="log", xlabel=f"error, {unit}", ylim=(len(rows) - 0.5, -0.5))
        ax.grid(color="#dddddd", linewidth=0.6)
    axes[0].set_yticks(range(len(rows)), [f"{k.replace('-', ', ')}, N = {n}" for k, n in rows])
    draw_chart_legend(fig)
    fig.subplots_adjust(left=0.21, right=0.985, top=0.92, bottom=0.075, wspace=0.05)
    return fig


def draw_chart_legend(fig: Figure) -> None:
    """Draw one entry per mark, above the axes."""
    shown = [k for k in CHART_MARKERS if k != "C++"]
    handles = [
        Line2D([], [], ls="", marker=CHART_MARKERS[k][0], color=CHART_MARKERS[k][1], ms=5.5)
        for k in shown
    ]
    fig.legend(handles, shown, loc="upper center", ncols=len(shown), frameon=False)


def render_error_chart_svg(
    lines: list[AccuracyLine], draw_statistics: dict[tuple[str, int], DrawStatistics]
) -> bytes:
    """Return the chart as SVG; the same numbers give the same bytes."""
    fig, buffer = draw_error_chart(lines, draw_statistics), io.StringIO()
    matplotlib.rcParams["svg.hashsalt"] = "benchmark"
    FigureCanvasSVG(fig).print_svg(buffer, metadata={"Date": None})
    return buffer.getvalue().encode()
