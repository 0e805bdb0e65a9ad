"""The 3-D view as a still picture: by the first guess, and by the result."""

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from calib.geometry import se3
from calib.report.figures import captions, scene_3d_data, svg_plots
from calib.report.figures.svg_plots import BLUE, GREY, INK, MUTED, RED

AZIMUTH, ELEVATION = np.radians(-60), np.radians(32)  # of the eye
MOST_POINTS = 900  # of a sensor
SIGNED = LinearSegmentedColormap.from_list("signed", [BLUE, GREY, RED])


def draw(run):
    """The Drawing, or None without a pose."""
    seen, shapes = scene_3d_data.sensors(run), scene_3d_data.shapes(run)
    if not seen:
        return None
    fig, axes = svg_plots.panels((1, 1), height=svg_plots.height_for(0.62, svg_plots.WIDE / 2))
    for ax, by in zip(axes, ("guess", "result"), strict=True):
        ends = [_targets(ax, shapes)] + [_sensor(ax, s, getattr(s, by)) for s in seen]
        ax.set_title({"guess": "by the first guess", "result": "by the result"}[by])
        _frame(ax, np.concatenate([e for e in ends if len(e)]))
    return svg_plots.drawing(fig, "scene", "Rig, targets and returns", captions.SCENE, span=0)


def _flat(points):
    """Points (n, 3) as they are seen (n, 2): without perspective."""
    a, e = AZIMUTH, ELEVATION
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    up = np.array([-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)])
    return np.reshape(points, (-1, 3)) @ np.stack([right, up]).T


def _targets(ax, shapes):
    gap = np.full((1, 2), np.nan)
    flat = [part for line in shapes for part in (_flat(line), gap)]
    if not flat:
        return np.zeros((0, 2))
    flat = np.concatenate(flat)
    ax.plot(*flat.T, color=MUTED, lw=0.5, alpha=0.6)
    return flat[np.isfinite(flat[:, 0])]


def _sensor(ax, seen, T):
    """Draw one sensor and its points by a pose; returns (n, 2) that must be in view."""
    if T is None:
        return np.zeros((0, 2))
    for line in scene_3d_data.glyph(seen.kind):
        ax.plot(*_flat(se3.transform(T, line)).T, color=INK, lw=0.9)
    every = len(seen.points) // MOST_POINTS + 1
    flat = _flat(se3.transform(T, seen.points[::every]))
    style = dict(s=2, cmap=SIGNED, vmin=-3, vmax=3, rasterized=True, linewidths=0)
    ax.scatter(*flat.T, c=seen.sigmas[::every], **style)
    name = dict(xytext=(4, 4), textcoords="offset points", fontsize=6.5)
    ax.annotate(seen.name, _flat(T[:3, 3])[0], **name)
    return flat


def _frame(ax, ends):
    """No axes, the same scale both ways, everything in view."""
    ax.set_axis_off()
    low, high = ends.min(0), ends.max(0)
    room = 0.04 * (high - low).max() + 1e-3
    ax.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
    ax.set(aspect="equal")
