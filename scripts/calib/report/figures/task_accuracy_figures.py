"""How many pixels a sensor's points may be off, over the image of each camera."""

import numpy as np

from calib.report import number_format
from calib.report.figures import captions, svg_plots
from calib.report.figures.svg_plots import BLUE, INK
from calib.report.sections import task_accuracy

DISTANCE = 10.0  # m
MOST = 3  # panels in a row


def draw(run, pairs):
    """Drawings, one a row of at most MOST images: σ at 10 m of every other sensor's points."""
    panels = [(c, p, m, T, C) for p in pairs for c, m, T, C in task_accuracy.in_cameras(run, p)]
    panels.sort(key=lambda panel: (panel[0], _other(panel)))
    rows = [panels[i : i + MOST] for i in range(0, len(panels), MOST)]
    return [_row(row, i) for i, row in enumerate(rows)]


def _other(panel):
    camera, pair = panel[:2]
    return pair["a"] if pair["b"] == camera else pair["b"]


def _row(panels, number):
    share = max(p[2].size[1] / p[2].size[0] for p in panels)
    fig, axes = svg_plots.panels(
        (1,) * MOST, height=svg_plots.height_for(share, svg_plots.WIDE / MOST)
    )
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    for ax, panel in zip(axes, panels, strict=False):
        _map(ax, panel)
    label = "Standard deviation of projected points over the image, px"
    return svg_plots.drawing(fig, f"task-{number}", label, captions.TASK, span=0)


def _map(ax, panel):
    """Lines of equal σ over one image."""
    camera, _, model, T, covariance = panel
    uv, sigma = task_accuracy.pixels(model, T, covariance, DISTANCE)
    if len(sigma) > 3 and np.ptp(sigma) > 1e-9 * sigma.max():
        lines = ax.tricontour(*uv.T, sigma, levels=5, colors=[BLUE], linewidths=1.1)
        ax.clabel(lines, fontsize=6.5, colors=[INK], fmt=lambda v: number_format.number(v, 3))
    if len(sigma):
        worst = uv[sigma.argmax()]
        ax.plot(*worst, "x", ms=5, color=INK, clip_on=False)
    width, height = model.size
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", anchor="W")
    ax.set(xlabel="u, px", ylabel="v, px", title=f"{_other(panel)} in {camera}")
