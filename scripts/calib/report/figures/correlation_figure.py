"""How the errors of all poses hang together."""

import numpy as np

from calib.report.figures import captions, svg_plots
from calib.report.figures.svg_plots import MUTED

NUMBERS = ("tx", "ty", "tz", "rx", "ry", "rz")
WIDTH, LEFT = 4.8, 1.0  # inch
LABELLED = 4  # sensors, up to which every number has its name


def draw(run):
    """The Drawing of the correlations of all numbers of all poses; None without a pose."""
    joint = run.calibration["joint_covariance"]
    if not joint:
        return None
    P, names = np.array(joint["matrix"]), joint["order"]
    sigma = np.sqrt(np.diag(P))
    if not (sigma > 0).all():
        return None
    side = WIDTH - LEFT - svg_plots.RIGHT
    fig, ax = svg_plots.figure(WIDTH, svg_plots.BOTTOM + svg_plots.TOP + side, LEFT)
    edges, shown = np.arange(len(P) + 1) - 0.5, P / np.outer(sigma, sigma)
    ax.pcolormesh(edges, edges, shown, cmap="RdBu_r", vmin=-1, vmax=1, rasterized=True)
    for k in range(6, len(P), 6):
        ax.axhline(k - 0.5, color=MUTED, lw=0.8)
        ax.axvline(k - 0.5, color=MUTED, lw=0.8)
    middle = 6 * np.arange(len(names)) + 2.5
    ax.yaxis.set_ticks(middle, names)
    if len(names) <= LABELLED:
        ax.xaxis.set_ticks(range(len(P)), NUMBERS * len(names))
        ax.tick_params(axis="x", labelsize=6, labelrotation=90)
    else:
        ax.xaxis.set_ticks(middle, names)
    ax.grid(visible=False)
    ax.set(ylim=(len(P) - 0.5, -0.5), aspect="equal", title="correlation of the poses")
    label = "Correlations of all numbers of all poses"
    return svg_plots.drawing(fig, "correlation", label, captions.CORRELATION, span=2)
