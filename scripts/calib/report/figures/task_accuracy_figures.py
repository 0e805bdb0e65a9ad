"""How many pixels a sensor's points may be off, over the image of each camera."""

import numpy as np

from calib.report.figures import svg_plots
from calib.report.figures.captions import PIXEL_SIGMA_MAP
from calib.report.figures.svg_plots import BLUE, INK_COLOR, PAGE_WIDTH_IN, compute_figure_height
from calib.report.number_format import format_number
from calib.report.sections.task_accuracy import list_pair_cameras, projection_uncertainty_px

MAP_DISTANCE_M = 10.0  # m
MAX_PANELS_PER_ROW = 3  # panels in a row


def draw_pixel_sigma_maps(run, pairs):
    """Drawings, one a row of at most MOST images: σ at 10 m of every other sensor's points."""
    panels = [(c, p, m, T, C) for p in pairs for c, m, T, C in list_pair_cameras(run, p)]
    panels.sort(key=lambda panel: (panel[0], _other_sensor(panel)))
    rows = [panels[i : i + MAX_PANELS_PER_ROW] for i in range(0, len(panels), MAX_PANELS_PER_ROW)]
    return [_draw_map_row(row, i) for i, row in enumerate(rows)]


def _other_sensor(panel):
    camera, pair = panel[:2]
    return pair["a"] if pair["b"] == camera else pair["b"]


def _draw_map_row(panels, number):
    share = max(p[2].size_px[1] / p[2].size_px[0] for p in panels)
    fig, axes = svg_plots.create_panels(
        (1,) * MAX_PANELS_PER_ROW,
        height=compute_figure_height(share, PAGE_WIDTH_IN / MAX_PANELS_PER_ROW),
    )
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    for ax, panel in zip(axes, panels, strict=False):
        _draw_sigma_map(ax, panel)
    label = "Standard deviation of projected points over the image, px"
    return svg_plots.finish_drawing(fig, f"task-{number}", label, PIXEL_SIGMA_MAP, column_span=0)


def _draw_sigma_map(ax, panel):
    """Lines of equal σ over one image."""
    camera, _, model, T, covariance = panel
    uv, sigma = projection_uncertainty_px(model, T, covariance, MAP_DISTANCE_M)
    if len(sigma) > 3 and np.ptp(sigma) > 1e-9 * sigma.max():
        lines = ax.tricontour(*uv.T, sigma, levels=5, colors=[BLUE], linewidths=1.1)
        ax.clabel(lines, fontsize=6.5, colors=[INK_COLOR], fmt=lambda v: format_number(v, 3))
    if len(sigma):
        worst = uv[sigma.argmax()]
        ax.plot(*worst, "x", ms=5, color=INK_COLOR, clip_on=False)
    width, height = model.size_px
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", anchor="W")
    ax.set(xlabel="u, px", ylabel="v, px", title=f"{_other_sensor(panel)} in {camera}")
