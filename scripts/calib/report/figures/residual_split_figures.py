"""Plots of residuals against what they may depend on, all kinds of a sensor together."""

import numpy as np
from scipy import stats

from calib.report.figures import captions, svg_plots
from calib.report.figures.svg_plots import CYCLE, MUTED
from calib.report.sections import residual_tables

SHOWN = ("target", "session", "speed")  # the other splits have plots of their own
QUANTILES = 60


def by_group(sensor, rows):
    """RMS over σ of every target, session and speed; None without a row."""
    rows = [r for r in rows if r["by"] in SHOWN]
    if not rows:
        return None
    names = list(
        dict.fromkeys((r["by"], r["group"]) for by in SHOWN for r in rows if r["by"] == by)
    )
    kinds = list(dict.fromkeys(r["kind"] for r in rows))
    height = 0.75 + 0.17 * len(names)
    fig, ax = svg_plots.figure(height=max(height, svg_plots.HEIGHT), left=1.35)
    for kind, colour in zip(kinds, CYCLE * 9, strict=False):
        own = [r for r in rows if r["kind"] == kind]
        y = [names.index((r["by"], r["group"])) for r in own]
        ax.plot([r["rms_sigma"] for r in own], y, "o", ms=4.5, color=colour, label=kind)
    ax.axvline(1, color=MUTED, lw=0.8, ls="--")
    ax.yaxis.set_ticks(range(len(names)), [group for _, group in names])
    ax.tick_params(axis="y", labelsize=7)
    largest = max(2.0, *(r["rms_sigma"] for r in rows))
    ax.set(ylim=(len(names) - 0.5, -1.6), xlim=(0, 1.1 * largest), xlabel="rms / σ")
    ax.set_title(f"{sensor}: by target, session, speed")
    ax.legend(loc="upper right", ncols=len(kinds), columnspacing=0.8, handletextpad=0.1)
    label = f"Residuals of {sensor} by target, session and speed"
    return svg_plots.drawing(fig, f"groups-{sensor}", label, captions.GROUPS)


def quantiles(sensor, kinds):
    """Quantiles of the residuals over σ against those of a normal; None without signed ones."""
    found = {k: residual_tables.normalised(c).ravel() for k, c in kinds.items()}
    found = {k: r for k, r in found.items() if residual_tables.signed(r)}
    if not found:
        return None
    fig, ax = svg_plots.figure()
    limit = 4.0
    for (kind, r), colour in zip(found.items(), CYCLE * 9, strict=False):
        ends = 0.5 / len(r)
        x = np.linspace(stats.norm.ppf(ends), stats.norm.ppf(1 - ends), QUANTILES)
        y = np.quantile(r, stats.norm.cdf(x))
        limit = max(limit, np.abs(y).max())
        ax.plot(x, y, lw=1.4, color=colour, label=kind)
    ax.plot([-4, 4], [-4, 4], color=MUTED, lw=0.8, ls="--")
    ax.set(xlabel="quantile of N(0, 1)", ylabel="residual / σ", xlim=(-4.5, 4.5))
    ax.set(ylim=(-1.05 * limit, 1.05 * limit), title=f"{sensor}: quantiles")
    ax.legend(loc="upper left")
    label = f"Quantiles of the residuals of {sensor}"
    return svg_plots.drawing(fig, f"quantiles-{sensor}", label, captions.QUANTILES)
