"""Plots of residuals against what they may depend on, all kinds of a sensor together."""

import numpy as np
from scipy import stats

from calib.report.figures import svg_plots
from calib.report.figures.captions import QUANTILE_PLOT, RMS_BY_GROUP
from calib.report.figures.svg_plots import COLOR_CYCLE, FIGURE_HEIGHT_IN, MUTED_COLOR, create_figure
from calib.report.sections.residual_tables import has_negative_residuals, standardize_residuals

SHOWN_SPLITS = ("target", "session", "speed")  # the other splits have plots of their own
N_QUANTILES = 60


def draw_rms_by_group(sensor, split_rows):
    """RMS over σ of every target, session and speed; None without a row."""
    split_rows = [r for r in split_rows if r["by"] in SHOWN_SPLITS]
    if not split_rows:
        return None
    names = list(
        dict.fromkeys(
            (r["by"], r["group"]) for by in SHOWN_SPLITS for r in split_rows if r["by"] == by
        )
    )
    kinds = list(dict.fromkeys(r["kind"] for r in split_rows))
    height = 0.75 + 0.17 * len(names)
    fig, ax = create_figure(height=max(height, FIGURE_HEIGHT_IN), left=1.35)
    for kind, colour in zip(kinds, COLOR_CYCLE * 9, strict=False):
        own = [r for r in split_rows if r["kind"] == kind]
        y = [names.index((r["by"], r["group"])) for r in own]
        ax.plot([r["rms_sigma"] for r in own], y, "o", ms=4.5, color=colour, label=kind)
    ax.axvline(1, color=MUTED_COLOR, lw=0.8, ls="--")
    ax.yaxis.set_ticks(range(len(names)), [group for _, group in names])
    ax.tick_params(axis="y", labelsize=7)
    largest = max(2.0, *(r["rms_sigma"] for r in split_rows))
    ax.set(ylim=(len(names) - 0.5, -1.6), xlim=(0, 1.1 * largest), xlabel="rms / σ")
    ax.set_title(f"{sensor}: by target, session, speed")
    ax.legend(loc="upper right", ncols=len(kinds), columnspacing=0.8, handletextpad=0.1)
    label = f"Residuals of {sensor} by target, session and speed"
    return svg_plots.finish_drawing(fig, f"groups-{sensor}", label, RMS_BY_GROUP)


def draw_quantile_plot(sensor, kinds):
    """Quantiles of the residuals over σ against those of a normal; None without signed ones."""
    found = {k: standardize_residuals(c).ravel() for k, c in kinds.items()}
    found = {k: r for k, r in found.items() if has_negative_residuals(r)}
    if not found:
        return None
    fig, ax = create_figure()
    limit = 4.0
    for (kind, r), colour in zip(found.items(), COLOR_CYCLE * 9, strict=False):
        ends = 0.5 / len(r)
        x = np.linspace(stats.norm.ppf(ends), stats.norm.ppf(1 - ends), N_QUANTILES)
        y = np.quantile(r, stats.norm.cdf(x))
        limit = max(limit, np.abs(y).max())
        ax.plot(x, y, lw=1.4, color=colour, label=kind)
    ax.plot([-4, 4], [-4, 4], color=MUTED_COLOR, lw=0.8, ls="--")
    ax.set(xlabel="quantile of N(0, 1)", ylabel="residual / σ", xlim=(-4.5, 4.5))
    ax.set(ylim=(-1.05 * limit, 1.05 * limit), title=f"{sensor}: quantiles")
    ax.legend(loc="upper left")
    label = f"Quantiles of the residuals of {sensor}"
    return svg_plots.finish_drawing(fig, f"quantiles-{sensor}", label, QUANTILE_PLOT)
