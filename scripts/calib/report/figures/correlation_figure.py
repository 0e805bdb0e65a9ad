"""Correlation of the errors of all poses."""

import numpy as np

from calib.report.data.run_data import ReportRun
from calib.report.figures import figure_encoding
from calib.report.figures.captions import CORRELATION_MATRIX
from calib.report.figures.figure_encoding import (
    MARGIN_BOTTOM_IN,
    MARGIN_RIGHT_IN,
    MARGIN_TOP_IN,
    MUTED_COLOR,
    Drawing,
    create_figure,
)

POSE_ERROR_LABELS = ("tx", "ty", "tz", "rx", "ry", "rz")
CORRELATION_WIDTH_IN, CORRELATION_LEFT_IN = 4.8, 1.0
MAX_LABELLED_SENSORS = 4  # with more sensors, single numbers have no labels


def draw_correlation_matrix(run: ReportRun) -> Drawing | None:
    """Draw the correlations of all numbers of all poses; None without a pose."""
    joint = run.calibration["joint_covariance"]
    if not joint:
        return None
    covariance, names = np.array(joint["matrix"]), joint["order"]
    n, sigma = len(covariance), np.sqrt(np.diag(covariance))
    if not (sigma > 0).all():
        return None
    side = CORRELATION_WIDTH_IN - CORRELATION_LEFT_IN - MARGIN_RIGHT_IN
    fig, ax = create_figure(
        CORRELATION_WIDTH_IN, MARGIN_BOTTOM_IN + MARGIN_TOP_IN + side, CORRELATION_LEFT_IN
    )
    edges, correlation = np.arange(n + 1) - 0.5, covariance / np.outer(sigma, sigma)
    ax.pcolormesh(edges, edges, correlation, cmap="RdBu_r", vmin=-1, vmax=1, rasterized=True)
    for k in range(6, n, 6):
        ax.axhline(k - 0.5, color=MUTED_COLOR, lw=0.8)
        ax.axvline(k - 0.5, color=MUTED_COLOR, lw=0.8)
    middle = 6 * np.arange(len(names)) + 2.5
    ax.yaxis.set_ticks(middle, names)
    if len(names) <= MAX_LABELLED_SENSORS:
        ax.xaxis.set_ticks(range(n), POSE_ERROR_LABELS * len(names))
        ax.tick_params(axis="x", labelsize=6, labelrotation=90)
    else:
        ax.xaxis.set_ticks(middle, names)
    ax.grid(visible=False)
    ax.set(ylim=(n - 0.5, -0.5), aspect="equal", title="correlation of the poses")
    return figure_encoding.finish_drawing(
        fig,
        "correlation",
        label="Correlations of all numbers of all poses",
        caption=CORRELATION_MATRIX,
        column_span=2,
    )
