"""The rig as calibrated: where its sensors sit, which way they look, and how sure that is."""

import numpy as np

from calib.report.figures import svg_plots
from calib.report.figures.captions import RIG_FIGURE, RIG_FIGURE_TRUTH
from calib.report.figures.svg_plots import (
    BLUE,
    COLOR_CYCLE,
    GUESS_COLOR,
    INK_COLOR,
    MUTED_COLOR,
    RESULT_COLOR,
)
from calib.report.sections.extrinsics import initial_guess_pose, xyz_rpy_difference, xyz_rpy_sigma

ARROW_LENGTH_M = 0.12  # length of the arrows at a sensor
MARGIN_M = 0.1
POSE_NUMBER_NAMES = ("x", "y", "z"), ("roll", "pitch", "yaw")
PROJECTIONS = (((0, 1), "x and y of the body", "x, m", "y, m"),
         ((0, 2), "x and z of the body", "x, m", "z, m"))  # fmt: skip


def draw_rig(run):
    """The Drawing of the whole rig; None where no sensor has a pose."""
    solved = [n for n in run.sensors if run.T_robot_sensor(n) is not None]
    if not solved:
        return None
    fig, axes = svg_plots.create_panels((1.2, 1.2, 1, 1), height=2.7)
    for ax, (at, title, xlabel, ylabel) in zip(axes, PROJECTIONS, strict=False):
        _plot_sensors(ax, run, solved, list(at))
        ax.set(title=title, xlabel=xlabel, ylabel=ylabel)
    for ax, part, unit in zip(axes[2:], (0, 1), ("mm", "°"), strict=True):
        _plot_sigma_bars(ax, run, solved, part, unit)
    known = any(run.T_robot_sensor_true(n) is not None for n in solved)
    caption = RIG_FIGURE + (RIG_FIGURE_TRUTH if known else "")
    label = "The sensors on the robot, and the standard deviations of their poses"
    return svg_plots.finish_drawing(fig, "rig", label, caption, column_span=0)


def _plot_sensors(ax, run, solved, plot_axes):
    """Sensors by the first guess and by the result, projected on two of the robot's axes."""
    ends = [np.zeros(2)]
    ax.plot(0, 0, "s", ms=5, color=INK_COLOR)
    ax.annotate("robot", (0, 0), (5, -8), textcoords="offset points", color=MUTED_COLOR, fontsize=7)
    for name in solved:
        guess = initial_guess_pose(run.sensors[name])
        for T, colour in ((guess, GUESS_COLOR), (run.T_robot_sensor(name), RESULT_COLOR)):
            if T is not None:
                ends += _plot_arrow(ax, T, _viewing_axis(run, name), plot_axes, colour)
    _plot_names(ax, run, solved, plot_axes)
    middle = (np.min(ends, axis=0) + np.max(ends, axis=0)) / 2
    box = ax.get_window_extent()
    shape = np.array([box.width, box.height]) / min(box.width, box.height)
    half = shape * (np.max(np.ptp(ends, axis=0) / shape) / 2 + MARGIN_M)
    low, high = middle - half, middle + half
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def _plot_names(ax, run, solved, plot_axes):
    """Names above or below their sensors, each on a line of its own."""
    origins = {n: run.T_robot_sensor(n)[plot_axes, 3] for n in solved}
    heights = [y for _, y in origins.values()]
    middle = (min(heights) + max(heights)) / 2
    line = dict(arrowstyle="-", color=MUTED_COLOR, lw=0.4)
    for side, va in ((1, "bottom"), (-1, "top")):
        names = [n for n in solved if (origins[n][1] >= middle) == (side > 0)]
        for k, name in enumerate(sorted(names, key=lambda n: origins[n][0])):
            where = dict(xytext=(0, side * (8 + 9 * (k % 4))), textcoords="offset points")
            ax.annotate(
                name, origins[name], arrowprops=line, fontsize=6.5, ha="center", va=va, **where
            )


def _viewing_axis(run, name):
    """The axis along which a sensor looks: a camera's z, a lidar's x."""
    return 2 if run.sensors[name]["kind"] == "camera" else 0


def _plot_arrow(ax, T, axis, plot_axes, colour):
    """Draw where a sensor is and looks; returns both ends, (2,) each."""
    start = T[plot_axes, 3]
    end = start + ARROW_LENGTH_M * T[plot_axes, axis]
    ax.plot(*np.transpose([start, end]), color=colour, lw=1.6, solid_capstyle="round")
    ax.plot(*start, "o", ms=4, color=colour)
    return [start, end]


def _plot_sigma_bars(ax, run, solved, part, unit):
    """σ of three numbers of every sensor as bars, the error against the truth as dots."""
    rows = slice(3 * part, 3 * part + 3)
    width = 0.8 / 3
    for i, name in enumerate(solved):
        T, T_true = run.T_robot_sensor(name), run.T_robot_sensor_true(name)
        sigma = xyz_rpy_sigma(T, run.sensors[name]["covariance"])[rows]
        x = i + width * np.arange(-1, 2)
        ax.bar(
            x,
            np.nan_to_num(sigma),
            0.9 * width,
            color=[BLUE, COLOR_CYCLE[1], COLOR_CYCLE[3]],
            alpha=0.8,
        )
        if T_true is not None:
            off = np.abs(xyz_rpy_difference(T, T_true)[rows])
            ax.plot(x, off, "D", ms=3.2, color=INK_COLOR)
    ax.xaxis.set_ticks(range(len(solved)), solved)
    ax.tick_params(axis="x", labelsize=6, labelrotation=15 if len(solved) > 2 else 0)
    for k, number in enumerate(POSE_NUMBER_NAMES[part]):
        ax.bar(0, 0, color=(BLUE, COLOR_CYCLE[1], COLOR_CYCLE[3])[k], label=number)
    ax.set(ylabel=f"σ, {unit}", title=("position σ", "rotation σ")[part])
    ax.set_ylim(0, 1.35 * max(ax.dataLim.y1, 1e-9))
    ax.legend(loc="upper right", ncols=3, columnspacing=0.8, handlelength=1, fontsize=6.5)
    ax.grid(axis="x", visible=False)
