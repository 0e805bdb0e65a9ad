"""The rig as calibrated: positions and viewing directions of its sensors, and σ of their poses."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from calib.report.data.run_data import ReportRun
from calib.report.figures import figure_encoding
from calib.report.figures.captions import RIG_FIGURE, RIG_FIGURE_TRUTH
from calib.report.figures.figure_encoding import (
    BLUE,
    COLOR_CYCLE,
    GUESS_COLOR,
    INK_COLOR,
    MUTED_COLOR,
    RESULT_COLOR,
    Drawing,
)
from calib.report.sections.extrinsics import initial_guess_pose, xyz_rpy_difference, xyz_rpy_sigma

ARROW_LENGTH_M = 0.12
MARGIN_M = 0.1
BAR_COLORS = (BLUE, COLOR_CYCLE[1], COLOR_CYCLE[3])


class Projection(NamedTuple):
    """A view of the rig along one axis of the robot; axes: those on the page."""

    axes: list[int]
    title: str
    xlabel: str
    ylabel: str


class PosePart(NamedTuple):
    """Three of the six numbers of a pose."""

    title: str
    names: tuple[str, str, str]
    rows: slice
    unit: str


PROJECTIONS = (
    Projection([0, 1], "x and y of the body", "x, m", "y, m"),
    Projection([0, 2], "x and z of the body", "x, m", "z, m"),
)
POSE_PARTS = (
    PosePart("position σ", ("x", "y", "z"), slice(0, 3), "mm"),
    PosePart("rotation σ", ("roll", "pitch", "yaw"), slice(3, 6), "°"),
)


def draw_rig(run: ReportRun) -> Drawing | None:
    """Draw the rig; None if no sensor has a pose."""
    poses = {n: T for n in run.sensors if (T := run.T_robot_sensor(n)) is not None}
    if not poses:
        return None
    fig, axes = figure_encoding.create_panels((1.2, 1.2, 1, 1), height=2.7)
    for ax, projection in zip(axes[:2], PROJECTIONS, strict=True):
        _plot_sensors(ax, run, poses, projection.axes)
        ax.set(title=projection.title, xlabel=projection.xlabel, ylabel=projection.ylabel)
    for ax, part in zip(axes[2:], POSE_PARTS, strict=True):
        _plot_sigma_bars(ax, run, poses, part)
    has_truth = any(run.T_robot_sensor_true(n) is not None for n in poses)
    return figure_encoding.finish_drawing(
        fig,
        "rig",
        label="The sensors on the robot, and the standard deviations of their poses",
        caption=RIG_FIGURE + (RIG_FIGURE_TRUTH if has_truth else ""),
        column_span=0,
    )


def _plot_sensors(
    ax: Axes, run: ReportRun, poses: dict[str, np.ndarray], plot_axes: list[int]
) -> None:
    """Plot the sensors by the initial guess and by the result, on two axes of the robot."""
    ends = [np.zeros(2)]
    ax.plot(0, 0, "s", ms=5, color=INK_COLOR)
    ax.annotate("robot", (0, 0), (5, -8), textcoords="offset points", color=MUTED_COLOR, fontsize=7)
    for name, T_result in poses.items():
        # A camera looks along its z axis, a lidar along x.
        axis = 2 if run.sensors[name]["kind"] == "camera" else 0
        guess = initial_guess_pose(run.sensors[name])
        for T, color in ((guess, GUESS_COLOR), (T_result, RESULT_COLOR)):
            if T is not None:
                start = T[plot_axes, 3]
                end = start + ARROW_LENGTH_M * T[plot_axes, axis]
                _plot_arrow(ax, start, end, color)
                ends += [start, end]
    _plot_names(ax, {name: T[plot_axes, 3] for name, T in poses.items()})
    _fit_limits(ax, np.array(ends))


def _plot_arrow(ax: Axes, start: np.ndarray, end: np.ndarray, color: str) -> None:
    ax.plot(*np.transpose([start, end]), color=color, lw=1.6, solid_capstyle="round")
    ax.plot(*start, "o", ms=4, color=color)


def _fit_limits(ax: Axes, points: np.ndarray) -> None:
    """Show points (n, 2) with a margin, at the same scale on both axes."""
    middle = (points.min(0) + points.max(0)) / 2
    box = ax.get_window_extent()
    shape = np.array([box.width, box.height]) / min(box.width, box.height)
    half = shape * (np.max(np.ptp(points, axis=0) / shape) / 2 + MARGIN_M)
    low, high = middle - half, middle + half
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def _plot_names(ax: Axes, origins: dict[str, np.ndarray]) -> None:
    """Write the names above or below their sensors, each on a line of its own."""
    heights = [y for _, y in origins.values()]
    middle = (min(heights) + max(heights)) / 2
    line = {"arrowstyle": "-", "color": MUTED_COLOR, "lw": 0.4}
    for side, va in ((1, "bottom"), (-1, "top")):
        names = [n for n, origin in origins.items() if (origin[1] >= middle) == (side > 0)]
        for k, name in enumerate(sorted(names, key=lambda n: origins[n][0])):
            ax.annotate(
                name,
                tuple(origins[name]),
                xytext=(0, side * (8 + 9 * (k % 4))),
                textcoords="offset points",
                arrowprops=line,
                fontsize=6.5,
                ha="center",
                va=va,
            )


def _plot_sigma_bars(
    ax: Axes, run: ReportRun, poses: dict[str, np.ndarray], part: PosePart
) -> None:
    """Plot σ of three numbers of all sensors as bars, and errors against the truth as diamonds."""
    width = 0.8 / 3
    for i, (name, T) in enumerate(poses.items()):
        sigma = xyz_rpy_sigma(T, run.sensors[name]["covariance"])[part.rows]
        x = i + width * np.arange(-1, 2)
        ax.bar(x, np.nan_to_num(sigma), 0.9 * width, color=BAR_COLORS, alpha=0.8)
        T_true = run.T_robot_sensor_true(name)
        if T_true is not None:
            error = np.abs(xyz_rpy_difference(T, T_true)[part.rows])
            ax.plot(x, error, "D", ms=3.2, color=INK_COLOR)
    ax.xaxis.set_ticks(range(len(poses)), list(poses))
    ax.tick_params(axis="x", labelsize=6, labelrotation=15 if len(poses) > 2 else 0)
    for color, name in zip(BAR_COLORS, part.names, strict=True):
        ax.bar(0, 0, color=color, label=name)
    ax.set(ylabel=f"σ, {part.unit}", title=part.title)
    ax.set_ylim(0, 1.35 * max(ax.dataLim.y1, 1e-9))
    ax.legend(loc="upper right", ncols=3, columnspacing=0.8, handlelength=1, fontsize=6.5)
    ax.grid(axis="x", visible=False)
