"""The figure of the benchmark: errors of all lines beside what others reach and the goals."""

import io

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarking.accuracy.accuracy_cases import DEFAULT
from benchmarking.accuracy.error_metrics import goal

SIZE = (9.0, 6.4)  # inch
MARKS = {  # marker, colour, size
    "surface": ("o", "#1f6fd6", 38),
    "points": ("s", "#d9820f", 26),
    "points, corners": ("^", "#1f9d63", 28),
    "goal": ("|", "#222222", 110),
    "paper": ("x", "#8a8f98", 28),
    "C++ points": ("D", "#c9a0ee", 18),
    "C++ points, corners": ("v", "#8f4fc4", 24),
    "C++": ("D", "#c9a0ee", 18),
}
FLOOR = (1e-6, 1e-7)  # mm, deg: below it an error is drawn at the edge


def marks(line, drawn):
    """{what: (mm, deg)} that one line puts into the figure; drawn: {(key, N): Statistics} of many
    draws of the noise, which say more than the error of one log."""
    out = {line.method: line.error}
    if line.method == DEFAULT:
        many = drawn.get((line.row.key, line.n))
        out["goal"] = goal(line.row, line.n, many or line)
        out[DEFAULT] = many.rms if many else line.error
        out["paper"] = line.row.paper.get(line.n)
    cpp = line.row.cpp.get(line.method, {}).get(line.n)
    out["C++" if line.method == DEFAULT else f"C++ {line.method}"] = cpp
    return {k: v for k, v in out.items() if v is not None and np.all(np.isfinite(v))}


def figure(lines, drawn):
    """Millimetres on the left, degrees on the right, one row per case and N."""
    matplotlib.rcdefaults()
    matplotlib.rcParams.update({"svg.fonttype": "none", "font.size": 8})
    rows = list(dict.fromkeys((line.row.key, line.n) for line in lines))
    fig = Figure(SIZE, facecolor="white")
    axes = fig.subplots(1, 2, sharey=True)
    for i, (ax, unit) in enumerate(zip(axes, ("mm", "deg"), strict=True)):
        for line in lines:
            for what, value in marks(line, drawn).items():
                marker, color, size = MARKS[what]
                y = rows.index((line.row.key, line.n))
                x = max(value[i], FLOOR[i])
                ax.scatter(x, y, size, color, marker=marker, linewidths=1.4, zorder=3)
        ax.set(xscale="log", xlabel=f"error, {unit}", ylim=(len(rows) - 0.5, -0.5))
        ax.grid(color="#dddddd", linewidth=0.6)
    axes[0].set_yticks(range(len(rows)), [f"{k.replace('-', ', ')}, N = {n}" for k, n in rows])
    legend(fig)
    fig.subplots_adjust(left=0.21, right=0.985, top=0.92, bottom=0.075, wspace=0.05)
    return fig


def legend(fig):
    """One entry per mark, above the axes."""
    shown = [k for k in MARKS if k != "C++"]
    handles = [Line2D([], [], ls="", marker=MARKS[k][0], color=MARKS[k][1], ms=5.5) for k in shown]
    fig.legend(handles, shown, loc="upper center", ncols=len(shown), frameon=False)


def svg(lines, drawn):
    """The figure as SVG, the same bytes for the same figures."""
    fig, buffer = figure(lines, drawn), io.StringIO()
    matplotlib.rcParams["svg.hashsalt"] = "benchmark"
    FigureCanvasSVG(fig).print_svg(buffer, metadata={"Date": None})
    return buffer.getvalue().encode()
