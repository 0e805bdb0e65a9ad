"""σ, in px, of a point of another sensor over the image of each camera."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from calib.report.data.run_data import ReportRun
from calib.report.figures import figure_encoding
from calib.report.figures.captions import PIXEL_SIGMA_MAP
from calib.report.figures.figure_encoding import (
    BLUE,
    INK_COLOR,
    PAGE_WIDTH_IN,
    Drawing,
    compute_figure_height,
)
from calib.report.number_format import format_number
from calib.report.sections.pairs import PairCamera, list_pair_cameras, projection_uncertainty_px

MAP_DISTANCE_M = 10.0
MAX_PANELS_PER_ROW = 3
CONTOUR_STYLE: dict[str, Any] = {"colors": [BLUE], "linewidths": 1.1}


def draw_pixel_sigma_maps(run: ReportRun, pairs: list[dict[str, Any]]) -> list[Drawing]:
    """Draw a map per camera and other sensor, up to MAX_PANELS_PER_ROW in each drawing."""
    cameras = [camera for pair in pairs for camera in list_pair_cameras(run, pair)]
    cameras.sort(key=lambda c: (c.camera, c.other))
    starts = range(0, len(cameras), MAX_PANELS_PER_ROW)
    rows = [cameras[i : i + MAX_PANELS_PER_ROW] for i in starts]
    return [_draw_map_row(row, f"task-{i}") for i, row in enumerate(rows)]


def _draw_map_row(cameras: list[PairCamera], name: str) -> Drawing:
    aspect = max(c.model.size_px[1] / c.model.size_px[0] for c in cameras)
    fig, axes = figure_encoding.create_panels(
        (1,) * MAX_PANELS_PER_ROW,
        height=compute_figure_height(aspect, PAGE_WIDTH_IN / MAX_PANELS_PER_ROW),
    )
    for ax in axes[len(cameras) :]:
        ax.set_axis_off()
    for ax, camera in zip(axes, cameras, strict=False):
        _plot_sigma_map(ax, camera)
    return figure_encoding.finish_drawing(
        fig,
        name,
        label="Standard deviation of projected points over the image, px",
        caption=PIXEL_SIGMA_MAP,
        column_span=0,
    )


def _plot_sigma_map(ax: Axes, camera: PairCamera) -> None:
    """Plot lines of equal σ over one image."""
    pixels, sigma = projection_uncertainty_px(camera.model, camera.covariance, MAP_DISTANCE_M)
    if len(sigma) > 3 and np.ptp(sigma) > 1e-9 * sigma.max():
        u, v = pixels.T
        lines = ax.tricontour(u, v, sigma, levels=5, **CONTOUR_STYLE)
        ax.clabel(lines, fontsize=6.5, colors=[INK_COLOR], fmt=lambda v: format_number(v, 3))
    if len(sigma):
        ax.plot(*pixels[sigma.argmax()], "x", ms=5, color=INK_COLOR, clip_on=False)
    width, height = camera.model.size_px
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", anchor="W")
    ax.set(xlabel="u, px", ylabel="v, px", title=f"{camera.other} in {camera.camera}")
