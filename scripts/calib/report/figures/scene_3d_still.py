"""The 3-D view as a still picture: by the first guess, and by the result."""

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from calib.geometry.se3 import transform_points
from calib.report.figures import svg_plots
from calib.report.figures.captions import SCENE_3D
from calib.report.figures.scene_3d_data import (
    collect_scene_sensors,
    collect_target_lines,
    trace_sensor_glyph,
)
from calib.report.figures.svg_plots import (
    BLUE,
    GREY,
    INK_COLOR,
    MUTED_COLOR,
    PAGE_WIDTH_IN,
    RED,
    compute_figure_height,
)

EYE_AZIMUTH_RAD, EYE_ELEVATION_RAD = np.radians(-60), np.radians(32)  # of the eye
MAX_POINTS = 900  # of a sensor
RESIDUAL_COLORMAP = LinearSegmentedColormap.from_list("signed", [BLUE, GREY, RED])


def draw_scene_still(run):
    """The Drawing, or None without a pose."""
    seen, shapes = collect_scene_sensors(run), collect_target_lines(run)
    if not seen:
        return None
    fig, axes = svg_plots.create_panels(
        (1, 1), height=compute_figure_height(0.62, PAGE_WIDTH_IN / 2)
    )
    for ax, by in zip(axes, ("guess", "result"), strict=True):
        ends = [_plot_targets(ax, shapes)] + [_plot_sensor(ax, s, getattr(s, by)) for s in seen]
        ax.set_title({"guess": "by the first guess", "result": "by the result"}[by])
        _fit_axes(ax, np.concatenate([e for e in ends if len(e)]))
    return svg_plots.finish_drawing(
        fig, "scene", "Rig, targets and returns", SCENE_3D, column_span=0
    )


def _project_points(points):
    """Points (n, 3) as they are seen (n, 2): without perspective."""
    a, e = EYE_AZIMUTH_RAD, EYE_ELEVATION_RAD
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    up = np.array([-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)])
    return np.reshape(points, (-1, 3)) @ np.stack([right, up]).T


def _plot_targets(ax, shapes):
    gap = np.full((1, 2), np.nan)
    flat = [part for line in shapes for part in (_project_points(line), gap)]
    if not flat:
        return np.zeros((0, 2))
    flat = np.concatenate(flat)
    ax.plot(*flat.T, color=MUTED_COLOR, lw=0.5, alpha=0.6)
    return flat[np.isfinite(flat[:, 0])]


def _plot_sensor(ax, scene_sensor, T):
    """Draw one sensor and its points by a pose; returns (n, 2) that must be in view."""
    if T is None:
        return np.zeros((0, 2))
    for line in trace_sensor_glyph(scene_sensor.kind):
        ax.plot(*_project_points(transform_points(T, line)).T, color=INK_COLOR, lw=0.9)
    every = len(scene_sensor.inlier_points) // MAX_POINTS + 1
    flat = _project_points(transform_points(T, scene_sensor.inlier_points[::every]))
    style = dict(s=2, cmap=RESIDUAL_COLORMAP, vmin=-3, vmax=3, rasterized=True, linewidths=0)
    ax.scatter(*flat.T, c=scene_sensor.standardized_residuals[::every], **style)
    name = dict(xytext=(4, 4), textcoords="offset points", fontsize=6.5)
    ax.annotate(scene_sensor.name, _project_points(T[:3, 3])[0], **name)
    return flat


def _fit_axes(ax, ends):
    """No axes, the same scale both ways, everything in view."""
    ax.set_axis_off()
    low, high = ends.min(0), ends.max(0)
    room = 0.04 * (high - low).max() + 1e-3
    ax.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
    ax.set(aspect="equal")
