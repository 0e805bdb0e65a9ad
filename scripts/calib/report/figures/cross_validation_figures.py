"""σ against the number of placements, and the influence of single placements."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.data.run_data import ReportRun
from calib.report.figures import figure_encoding
from calib.report.figures.captions import PLACEMENT_INFLUENCE, SIGMA_BY_PLACEMENTS
from calib.report.figures.figure_encoding import (
    BLUE,
    MUTED_COLOR,
    ORANGE,
    Drawing,
    create_figure,
    cycle_colors,
)
from calib.report.sections.cross_validation import list_placement_influences

MAX_TICKS = 12


def draw_sigma_by_placements(run: ReportRun) -> Drawing | None:
    """Draw the largest σ of each pose against the number of placements; None without any."""
    blocks = {
        name: sensor["sigma_by_placements"]
        for name, sensor in run.sensors.items()
        if sensor["sigma_by_placements"] and len(sensor["sigma_by_placements"]["placements"]) > 1
    }
    if not blocks:
        return None
    fig, (position, rotation) = figure_encoding.create_panels((1, 1), height=2.6)
    limits = run.verdict["limits"]
    _plot_sigma_curves(position, blocks, "sigma_m", MM_PER_M, limits["warn_sigma_m"] * MM_PER_M)
    position.set(ylabel="σ, mm", title="largest σ of the position")
    _plot_sigma_curves(rotation, blocks, "sigma_rad", DEG_PER_RAD, limits["warn_sigma_deg"])
    rotation.set(ylabel="σ, °", title="largest σ of the rotation")
    position.legend(loc="upper right")
    return figure_encoding.finish_drawing(
        fig,
        "sigma-by-count",
        label="Sigma of each sensor against the number of placements",
        caption=SIGMA_BY_PLACEMENTS,
        column_span=0,
    )


def _plot_sigma_curves(
    ax: Axes, blocks: dict[str, dict[str, Any]], key: str, scale: float, limit: float
) -> None:
    """Plot one curve per sensor, and the warn limit in the same unit if it is near."""
    largest = 0.0
    for (name, block), color in zip(blocks.items(), cycle_colors(), strict=False):
        sigma = [np.nan if v is None else v * scale for v in block[key]]
        largest = np.nanmax([largest, *sigma])
        ax.plot(block["placements"], sigma, "o-", ms=3.5, lw=1.2, color=color, label=name)
    if limit < 5 * largest:
        ax.axhline(limit, color=MUTED_COLOR, lw=0.8, ls="--", label="warn above")
    ax.set(xlabel="placements", ylim=(0, None))


def draw_placement_influence(run: ReportRun, sensor: str) -> Drawing | None:
    """Draw the shift of a pose without each placement, and its leave-one-out error; None of one."""
    rows = list_placement_influences(run, sensor)
    if len(rows) < 2:
        return None
    fig, ax = create_figure()
    x = np.arange(len(rows))
    shift = np.array([np.nan if r.influence is None else r.influence for r in rows])
    error = np.sqrt(
        [np.nan if r.nees_per_direction is None else r.nees_per_direction for r in rows]
    )
    ax.bar(x, shift, color=BLUE, alpha=0.75, width=0.7, label="shift of the pose, σ")
    ax.plot(x, error, "o", ms=4, color=ORANGE, label="error, σ")
    ax.axhline(1, color=MUTED_COLOR, lw=0.8, ls="--")
    step = -(-len(rows) // MAX_TICKS)
    ax.xaxis.set_ticks(x[::step], [str(r.placement) for r in rows[::step]])
    top = max(2.0, *np.nan_to_num(shift), *np.nan_to_num(error))
    ax.set(xlabel="placement left out", ylabel="in σ", ylim=(0, top * 1.3))
    ax.set_title(f"{sensor}: leave-one-out")
    ax.legend(loc="upper right", ncols=2)
    return figure_encoding.finish_drawing(
        fig,
        f"influence-{sensor}",
        label=f"Leave-one-out of the placements of {sensor}",
        caption=PLACEMENT_INFLUENCE,
    )
