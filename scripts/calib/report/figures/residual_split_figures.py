"""Figures of residuals by group and by quantile, all kinds of a sensor together."""

from typing import Any

import numpy as np
from scipy import stats

from calib.report.data.run_data import Columns
from calib.report.figures import figure_encoding
from calib.report.figures.captions import QUANTILE_PLOT, RMS_BY_GROUP
from calib.report.figures.figure_encoding import (
    FIGURE_HEIGHT_IN,
    MUTED_COLOR,
    Drawing,
    create_figure,
    cycle_colors,
)
from calib.report.number_format import format_kind
from calib.report.sections.residuals import has_negative_residuals, standardize_residuals

SHOWN_SPLITS = ("target", "session", "speed")  # the other splits have figures of their own
N_QUANTILES = 60


def draw_rms_by_group(sensor: str, split_rows: list[dict[str, Any]]) -> Drawing | None:
    """Draw the rms in σ of each target, session and speed; None without a row.

    split_rows: of tabulate_residual_splits.
    """
    split_rows = [r for r in split_rows if r["by"] in SHOWN_SPLITS]
    if not split_rows:
        return None
    groups = list(
        dict.fromkeys(
            (r["by"], r["group"]) for by in SHOWN_SPLITS for r in split_rows if r["by"] == by
        )
    )
    kinds = list(dict.fromkeys(r["kind"] for r in split_rows))
    height = 0.75 + 0.17 * len(groups)
    fig, ax = create_figure(height=max(height, FIGURE_HEIGHT_IN), left=1.35)
    for kind, color in zip(kinds, cycle_colors(), strict=False):
        rows = [r for r in split_rows if r["kind"] == kind]
        y = [groups.index((r["by"], r["group"])) for r in rows]
        ax.plot([r["rms_sigma"] for r in rows], y, "o", ms=4.5, color=color, label=kind)
    ax.axvline(1, color=MUTED_COLOR, lw=0.8, ls="--")
    ax.yaxis.set_ticks(range(len(groups)), [group for _, group in groups])
    ax.tick_params(axis="y", labelsize=7)
    largest = max(2.0, *(r["rms_sigma"] for r in split_rows))
    ax.set(ylim=(len(groups) - 0.5, -1.6), xlim=(0, 1.1 * largest), xlabel="rms / σ")
    ax.set_title(f"{sensor}: by target, session, speed")
    ax.legend(loc="upper right", ncols=len(kinds), columnspacing=0.8, handletextpad=0.1)
    return figure_encoding.finish_drawing(
        fig,
        f"groups-{sensor}",
        label=f"Residuals of {sensor} by target, session and speed",
        caption=RMS_BY_GROUP,
    )


def draw_quantile_plot(sensor: str, inliers: dict[str, Columns]) -> Drawing | None:
    """Draw the quantiles of standardized residuals against N(0, 1); None without signed ones."""
    residuals = {kind: standardize_residuals(columns).ravel() for kind, columns in inliers.items()}
    residuals = {kind: r for kind, r in residuals.items() if has_negative_residuals(r)}
    if not residuals:
        return None
    fig, ax = create_figure()
    limit = 4.0
    for (kind, r), color in zip(residuals.items(), cycle_colors(), strict=False):
        tail = 0.5 / len(r)
        x = np.linspace(stats.norm.ppf(tail), stats.norm.ppf(1 - tail), N_QUANTILES)
        y = np.quantile(r, stats.norm.cdf(x))
        limit = max(limit, np.abs(y).max())
        ax.plot(x, y, lw=1.4, color=color, label=format_kind(kind))
    ax.plot([-4, 4], [-4, 4], color=MUTED_COLOR, lw=0.8, ls="--")
    ax.set(xlabel="quantile of N(0, 1)", ylabel="residual / σ", xlim=(-4.5, 4.5))
    ax.set(ylim=(-1.05 * limit, 1.05 * limit), title=f"{sensor}: quantiles")
    ax.legend(loc="upper left")
    label = f"Quantiles of the residuals of {sensor}"
    return figure_encoding.finish_drawing(
        fig, f"quantiles-{sensor}", label=label, caption=QUANTILE_PLOT
    )
