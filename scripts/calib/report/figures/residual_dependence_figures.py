"""Figures of residuals against what they may depend on: ring, range, incidence, image position."""

from typing import Any, NamedTuple

import numpy as np

from calib.geometry.units import MM_PER_M
from calib.report.data.run_data import Columns
from calib.report.figures import figure_encoding
from calib.report.figures.captions import (
    CAMERA_RESIDUALS_BY_INCIDENCE,
    LIDAR_RESIDUALS_BY_INCIDENCE,
    RESIDUAL_VECTORS,
    RESIDUALS_BY_RANGE,
    RESIDUALS_BY_RING,
)
from calib.report.figures.figure_encoding import (
    BLUE,
    FIGURE_WIDTH_IN,
    GREY,
    MUTED_COLOR,
    RED,
    Drawing,
    compute_figure_height,
    create_figure,
)
from calib.report.number_format import floor_to_nice_number, format_number
from calib.report.sections.residuals import standardize_residuals

MIN_GROUP_SIZE = 5  # smaller groups of residuals are not drawn
N_BINS = 12
N_IMAGE_CELLS = (8, 6)  # columns and rows
BAR_QUANTILES = (0.16, 0.5, 0.84)
MAX_VECTOR_STROKES = 400  # more strokes are drawn as pixels
ONE_SIGMA_BAND = (-1, 1)
QUIVER_TO_SCALE: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1}
STROKE_STYLE = QUIVER_TO_SCALE | {
    "width": 0.002,
    "color": GREY,
    "alpha": 0.8,
    "headwidth": 0,
    "headlength": 0,
    "headaxislength": 0,
}
ARROW_STYLE = QUIVER_TO_SCALE | {
    "width": 0.006,
    "color": RED,
    "headwidth": 3,
    "headlength": 3,
    "headaxislength": 3,
}


class DependencePlot(NamedTuple):
    """Residuals in groups of a quantity: (value of the quantity, residuals (n,)) per group."""

    quantity: str
    groups: list[tuple[float, np.ndarray]]
    xlabel: str
    caption: str
    ylabel: str = "residual / σ"
    band: tuple[float, float] | None = ONE_SIGMA_BAND


class ImageCellMeans(NamedTuple):
    """Centres (k, 2), mean residuals (k, 2) and their σ (k,), px, of cells of an image."""

    centres: np.ndarray
    means: np.ndarray
    sigma: np.ndarray


def draw_lidar_dependences(sensor: str, inliers: Columns) -> list[Drawing]:
    """Draw the residuals of the returns of a lidar by ring, range and angle of incidence."""
    residual_mm = inliers["value"][:, 0] * MM_PER_M
    standardized = inliers["value"][:, 0] / inliers["sigma"]
    ring = np.asarray(inliers["feature_index"])
    cosine = np.asarray(inliers["cos_incidence"])
    angle_deg = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    rings = [(k, residual_mm[ring == k]) for k in np.unique(ring[ring >= 0])]
    ranges = _split_into_bins(np.asarray(inliers["range_m"]), standardized)
    # Residuals between points have no incidence: the column is 0.
    angles = _split_into_bins(angle_deg, standardized) if cosine.any() else []
    plots = (
        DependencePlot("ring", rings, "ring (beam)", RESIDUALS_BY_RING, "residual, mm", None),
        DependencePlot("range", ranges, "range, m", RESIDUALS_BY_RANGE),
        DependencePlot("incidence", angles, "angle of incidence, °", LIDAR_RESIDUALS_BY_INCIDENCE),
    )
    return [_draw_dependence(sensor, plot) for plot in plots if plot.groups]


def draw_camera_dependences(sensor: str, inliers: list[Columns]) -> list[Drawing]:
    """Draw the residuals of a camera by range and angle of incidence, all kinds together."""
    residuals = [standardize_residuals(columns) for columns in inliers]
    standardized = np.concatenate([r.ravel() for r in residuals])
    range_m, cosine = (
        np.concatenate(
            [np.repeat(c[name], r.shape[1]) for c, r in zip(inliers, residuals, strict=True)]
        )
        for name in ("range_m", "cos_incidence")
    )
    ranges = _split_into_bins(range_m, standardized)
    plots = [DependencePlot("range", ranges, "range, m", RESIDUALS_BY_RANGE)]
    if cosine.any():
        angle_deg = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        angles = _split_into_bins(angle_deg, standardized)
        caption = CAMERA_RESIDUALS_BY_INCIDENCE
        plots.append(DependencePlot("incidence", angles, "angle of incidence, °", caption))
    return [_draw_dependence(sensor, plot) for plot in plots]


def _split_into_bins(x: np.ndarray, residuals: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Return (middle, residuals) of N_BINS equal bins of x (n,)."""
    edges = np.linspace(x.min(), x.max() + 1e-9, N_BINS + 1)
    bins = np.digitize(x, edges) - 1
    return [((edges[k] + edges[k + 1]) / 2, residuals[bins == k]) for k in range(N_BINS)]


def _draw_dependence(sensor: str, plot: DependencePlot) -> Drawing:
    """Draw median and quantiles of each group."""
    fig, ax = create_figure()
    groups = [
        (x, np.quantile(r, BAR_QUANTILES)) for x, r in plot.groups if len(r) >= MIN_GROUP_SIZE
    ]
    if plot.band:
        ax.axhspan(*plot.band, color=GREY, alpha=0.15, lw=0)
    ax.axhline(0, color=MUTED_COLOR, lw=0.8)
    if groups:
        x, (low, median, high) = [x for x, _ in groups], np.array([q for _, q in groups]).T
        bars = [median - low, high - median]
        ax.errorbar(x, median, bars, fmt="o", ms=3.5, lw=1.2, color=BLUE)
    ax.set(xlabel=plot.xlabel, ylabel=plot.ylabel, title=f"{sensor}: by {plot.quantity}")
    return figure_encoding.finish_drawing(
        fig,
        f"{plot.quantity}-{sensor}",
        label=f"Residuals of {sensor} by {plot.quantity}",
        caption=plot.caption,
    )


def draw_residual_vectors(sensor: str, inliers: list[Columns], size_px: tuple[int, int]) -> Drawing:
    """Draw the residuals over the image: each of them, and the mean of each cell."""
    pixels = np.concatenate([c["measured"][:, :2] for c in inliers])
    value = np.concatenate([c["value"] for c in inliers])
    width, height = size_px
    cells = average_image_cells(pixels, value, size_px)
    lengths = np.linalg.norm(cells.means, axis=1)
    longest = lengths.max(initial=0.0)
    large = np.quantile(np.linalg.norm(value, axis=1), 0.9)
    gain = floor_to_nice_number(width / 9 / max(large, 1e-6))
    mean_gain = floor_to_nice_number(width / 9 / max(longest, 1e-6)) if len(lengths) else gain
    figure_width = 1.4 * FIGURE_WIDTH_IN
    fig, ax = create_figure(figure_width, compute_figure_height(height / width, figure_width))
    is_dense = len(pixels) > MAX_VECTOR_STROKES
    ax.quiver(*pixels.T, *(value * gain).T, rasterized=is_dense, **STROKE_STYLE)
    ax.quiver(*cells.centres.T, *(cells.means * mean_gain).T, **ARROW_STYLE)
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    ax.set(xlabel="u, px", ylabel="v, px", title=f"{sensor}: over the image")
    caption = RESIDUAL_VECTORS.format(
        gain=format_number(gain),
        mean_gain=format_number(mean_gain),
        min_count=MIN_GROUP_SIZE,
        longest=format_number(longest, 2),
        n_beyond=int(np.sum(lengths > 3 * cells.sigma)),
        n_cells=len(lengths),
    )
    return figure_encoding.finish_drawing(
        fig,
        f"vectors-{sensor}",
        label=f"Residual vectors of {sensor} over the image",
        caption=caption,
        column_span=2,
    )


def average_image_cells(
    pixels: np.ndarray, residuals: np.ndarray, size_px: tuple[int, int]
) -> ImageCellMeans:
    """Return the mean residual of the cells of an image with enough residuals (n, 2)."""
    width, height = size_px
    columns, rows = N_IMAGE_CELLS
    i = np.clip((pixels[:, 0] + 0.5) * columns / width, 0, columns - 1).astype(int)
    j = np.clip((pixels[:, 1] + 0.5) * rows / height, 0, rows - 1).astype(int)
    out = []
    for cell in np.unique(np.column_stack([i, j]), axis=0):
        inside = (i == cell[0]) & (j == cell[1])
        if inside.sum() >= MIN_GROUP_SIZE:
            sigma = np.sqrt(residuals[inside].var(0).mean() / inside.sum())
            centre = (cell + 0.5) * [width / columns, height / rows] - 0.5
            out.append([*centre, *residuals[inside].mean(0), sigma])
    table = np.reshape(out, (-1, 5))
    return ImageCellMeans(table[:, :2], table[:, 2:4], table[:, 4])
