"""The 3-D view as a still picture: by the initial guess, and by the result."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap

from calib.geometry.se3 import transform_points
from calib.report.data.run_data import ReportRun
from calib.report.figures import figure_encoding
from calib.report.figures.captions import SCENE_3D
from calib.report.figures.figure_encoding import (
    BLUE,
    GREY,
    INK_COLOR,
    MUTED_COLOR,
    PAGE_WIDTH_IN,
    RED,
    Drawing,
    compute_figure_height,
)
from calib.report.figures.scene_3d_data import (
    SceneSensor,
    collect_scene_sensors,
    collect_target_lines,
    trace_sensor_glyph,
)

EYE_AZIMUTH_RAD, EYE_ELEVATION_RAD = np.radians(-60), np.radians(32)
MAX_POINTS = 900  # per sensor
RESIDUAL_COLORMAP = LinearSegmentedColormap.from_list("signed", [BLUE, GREY, RED])


def draw_scene_still(run: ReportRun) -> Drawing | None:
    """Draw the rig, the targets and the inliers; None without a pose."""
    sensors, target_lines = collect_scene_sensors(run), collect_target_lines(run)
    if not sensors:
        return None
    fig, axes = figure_encoding.create_panels(
        (1, 1), height=compute_figure_height(0.62, PAGE_WIDTH_IN / 2)
    )
    for ax, title, poses in (
        (axes[0], "by the initial guess", [s.guess for s in sensors]),
        (axes[1], "by the result", [s.result for s in sensors]),
    ):
        points = [_plot_targets(ax, target_lines)]
        points += [_plot_sensor(ax, s, T) for s, T in zip(sensors, poses, strict=True)]
        ax.set_title(title)
        _fit_axes(ax, np.concatenate([p for p in points if len(p)]))
    return figure_encoding.finish_drawing(
        fig, "scene", label="Rig, targets and inliers", caption=SCENE_3D, column_span=0
    )


def _project_points(points: np.ndarray) -> np.ndarray:
    """Return points (n, 3) as the eye sees them (n, 2), without perspective."""
    a, e = EYE_AZIMUTH_RAD, EYE_ELEVATION_RAD
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    up = np.array([-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)])
    return np.reshape(points, (-1, 3)) @ np.stack([right, up]).T


def _plot_targets(ax: Axes, lines: list[np.ndarray]) -> np.ndarray:
    """Plot the lines of the targets; return their points (n, 2)."""
    gap = np.full((1, 2), np.nan)
    parts = [part for line in lines for part in (_project_points(line), gap)]
    if not parts:
        return np.zeros((0, 2))
    points = np.concatenate(parts)
    ax.plot(*points.T, color=MUTED_COLOR, lw=0.5, alpha=0.6)
    return points[np.isfinite(points[:, 0])]


def _plot_sensor(ax: Axes, sensor: SceneSensor, T: np.ndarray | None) -> np.ndarray:
    """Plot one sensor and its inliers by a pose; return the points (n, 2) to show."""
    if T is None:
        return np.zeros((0, 2))
    for line in trace_sensor_glyph(sensor.kind):
        ax.plot(*_project_points(transform_points(T, line)).T, color=INK_COLOR, lw=0.9)
    every = len(sensor.inlier_points) // MAX_POINTS + 1
    points = _project_points(transform_points(T, sensor.inlier_points[::every]))
    x, y = points.T
    ax.scatter(
        x,
        y,
        c=sensor.standardized_residuals[::every],
        s=2,
        cmap=RESIDUAL_COLORMAP,
        vmin=-3,
        vmax=3,
        rasterized=True,
        linewidths=0,
    )
    origin = _project_points(T[:3, 3])[0]
    ax.annotate(sensor.name, origin, xytext=(4, 4), textcoords="offset points", fontsize=6.5)
    return points


def _fit_axes(ax: Axes, points: np.ndarray) -> None:
    """Show all points (n, 2) at the same scale on both axes, which are hidden."""
    ax.set_axis_off()
    low, high = points.min(0), points.max(0)
    margin = 0.04 * (high - low).max() + 1e-3
    ax.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    ax.set(aspect="equal")
