"""Plots of σ against the number of placements, and of what single placements do."""

import numpy as np

from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.figures import svg_plots
from calib.report.figures.captions import PLACEMENT_INFLUENCE, SIGMA_BY_PLACEMENTS
from calib.report.figures.svg_plots import BLUE, COLOR_CYCLE, MUTED_COLOR, ORANGE, create_figure
from calib.report.sections.cross_validation import list_placement_influences


def draw_sigma_by_placements(run):
    """σ of every sensor's pose with the first so many of its placements; None without any."""
    found = {
        n: s["sigma_by_placements"] for n, s in run.sensors.items() if s["sigma_by_placements"]
    }
    found = {n: p for n, p in found.items() if len(p["placements"]) > 1}
    if not found:
        return None
    fig, axes = svg_plots.create_panels((1, 1), height=2.6)
    limits = run.verdict["limits"]
    for ax, key, scale, unit in zip(
        axes, ("m", "rad"), (MM_PER_M, DEG_PER_RAD), ("mm", "°"), strict=True
    ):
        largest = 0.0
        for (name, p), colour in zip(found.items(), COLOR_CYCLE * 9, strict=False):
            y = [np.nan if v is None else v * scale for v in p[f"sigma_{key}"]]
            largest = np.nanmax([largest, *y])
            ax.plot(p["placements"], y, "o-", ms=3.5, lw=1.2, color=colour, label=name)
        limit = limits["warn_sigma_m"] * MM_PER_M if key == "m" else limits["warn_sigma_deg"]
        if limit < 5 * largest:
            ax.axhline(limit, color=MUTED_COLOR, lw=0.8, ls="--", label="warn above")
        ax.set(xlabel="placements", ylabel=f"σ, {unit}", ylim=(0, None))
        ax.set_title("largest σ of the " + ("position" if key == "m" else "rotation"))
    axes[0].legend(loc="upper right")
    label = "Sigma of every sensor against the number of placements"
    return svg_plots.finish_drawing(
        fig, "sigma-by-count", label, SIGMA_BY_PLACEMENTS, column_span=0
    )


def draw_placement_influence(run, sensor):
    """What every placement left out does to one sensor's pose, and how unlike the others it is."""
    rows = list_placement_influences(run, sensor)
    if len(rows) < 2:
        return None
    fig, ax = create_figure()
    x = np.arange(len(rows))
    moved = np.array([np.nan if r[3] is None else r[3] for r in rows])
    unlike = np.sqrt([np.nan if r[4] is None else r[4] for r in rows])
    ax.bar(x, moved, color=BLUE, alpha=0.75, width=0.7, label="moves the pose, σ")
    ax.plot(x, unlike, "o", ms=4, color=ORANGE, label="unlike the others, σ")
    ax.axhline(1, color=MUTED_COLOR, lw=0.8, ls="--")
    step = -(-len(rows) // 12)
    ax.xaxis.set_ticks(x[::step], [str(r[2]) for r in rows[::step]])
    top = max(2.0, *np.nan_to_num(moved), *np.nan_to_num(unlike))
    ax.set(xlabel="placement left out", ylabel="in σ", ylim=(0, top * 1.3))
    ax.set_title(f"{sensor}: placements left out")
    ax.legend(loc="upper right", ncols=2)
    label = f"Placements of {sensor} left out"
    return svg_plots.finish_drawing(fig, f"influence-{sensor}", label, PLACEMENT_INFLUENCE)
