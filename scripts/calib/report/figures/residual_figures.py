"""Residual figures of one sensor: histograms, pixels, and rms by placement."""

import numpy as np

from calib.report.data.run_data import Columns, ReportRun
from calib.report.figures import figure_encoding
from calib.report.figures.captions import (
    PIXEL_RESIDUALS,
    PLACEMENT_RMS,
    PLACEMENT_RMS_SESSIONS,
    RESIDUAL_HISTOGRAM,
    STANDARDIZED_HISTOGRAM,
    STANDARDIZED_HISTOGRAM_GOOD,
    STANDARDIZED_HISTOGRAM_NORMAL,
)
from calib.report.figures.figure_encoding import (
    BLUE,
    COLOR_CYCLE,
    GREEN,
    INK_COLOR,
    MUTED_COLOR,
    ORANGE,
    Drawing,
    compute_figure_height,
    create_figure,
)
from calib.report.figures.residual_dependence_figures import (
    draw_camera_dependences,
    draw_lidar_dependences,
    draw_residual_vectors,
)
from calib.report.number_format import (
    choose_decimals,
    format_count,
    format_decimals,
    format_kind,
    format_number,
)
from calib.report.sections.residuals import (
    KIND_DESCRIPTIONS,
    TAIL_LIMIT_SIGMA,
    count_tail_residuals,
    has_negative_residuals,
    inliers_by_kind,
    printed_unit,
    residual_components,
    rms_by_placement,
    root_mean_square,
    select_main_lidar_residuals,
    standardize_residuals,
)

N_BINS = 41
MAX_TICKS = 12


def draw_residual_figures(run: ReportRun, sensor: str) -> list[Drawing]:
    """Draw the residuals of one sensor, in reading order; none without an inlier."""
    inliers = inliers_by_kind(run, sensor)
    if not inliers:
        return []
    in_image = [c for c in inliers.values() if residual_components(c).shape[1] == 2]
    drawings = []
    for kind, columns in inliers.items():
        drawings.append(draw_standardized_histogram(sensor, kind, columns))
        if residual_components(columns).shape[1] == 2:
            drawings.append(draw_pixel_residuals(sensor, kind, columns))
        else:
            drawings.append(draw_residual_histogram(sensor, kind, columns))
    drawings.append(draw_placement_rms(sensor, inliers))
    main = select_main_lidar_residuals(inliers)
    if main is not None:
        drawings += draw_lidar_dependences(sensor, main)
    else:
        drawings += draw_camera_dependences(sensor, list(inliers.values()))
    if in_image:
        size_px = run.options["sensors"][sensor]["size_px"]
        drawings.append(draw_residual_vectors(sensor, in_image, size_px))
    return drawings


def draw_standardized_histogram(sensor: str, kind: str, inliers: Columns) -> Drawing:
    """Draw the histogram of the standardized residuals against N(0, 1)."""
    r = standardize_residuals(inliers).ravel()
    limit = max(4.0, np.ceil(np.abs(r).max()))
    edges = np.linspace(-limit, limit, N_BINS)
    fig, ax = create_figure()
    ax.stairs(np.histogram(r, edges)[0], edges, fill=True, color=BLUE, alpha=0.75)
    if has_negative_residuals(r):
        x = np.linspace(-limit, limit, 200)
        normal = np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi) * len(r) * (edges[1] - edges[0])
        ax.plot(x, normal, color=ORANGE, lw=1.4, label="N(0, 1)")
        ax.legend(loc="upper right")
    for side in (-TAIL_LIMIT_SIGMA, TAIL_LIMIT_SIGMA):
        ax.axvline(side, color=MUTED_COLOR, lw=0.7, ls=":")
    name = f"{sensor}, {format_kind(kind)}"
    ax.set(xlabel="residual / σ", ylabel="count", title=f"{name}: in units of σ")
    return figure_encoding.finish_drawing(
        fig,
        f"sigma-{sensor}-{kind}",
        label=f"Residuals of {sensor} {format_kind(kind)} over sigma",
        caption=_describe_standardized_histogram(kind, r),
    )


def _describe_standardized_histogram(kind: str, standardized: np.ndarray) -> str:
    n_beyond, expected = count_tail_residuals(standardized)
    is_signed = has_negative_residuals(standardized)
    shape = "signed" if is_signed else "length"
    normal = STANDARDIZED_HISTOGRAM_NORMAL.format(expected=format_number(expected, 2))
    return STANDARDIZED_HISTOGRAM.format(
        n=format_count(len(standardized)),
        rms=format_decimals(root_mean_square(standardized), 2),
        n_beyond=format_count(n_beyond),
        normal=normal if is_signed else "",
        good=STANDARDIZED_HISTOGRAM_GOOD.get(kind, STANDARDIZED_HISTOGRAM_GOOD[shape]),
    )


def draw_residual_histogram(sensor: str, kind: str, inliers: Columns) -> Drawing:
    """Draw the histogram of residuals of one component, in mm, degrees or pixels."""
    unit, scale = printed_unit(kind)
    r = residual_components(inliers).ravel() * scale
    limit = np.abs(r).max() * 1.02 + 1e-12
    low = -limit if has_negative_residuals(r) else 0.0
    fig, ax = create_figure()
    counts, edges = np.histogram(r, np.linspace(low, limit, N_BINS))
    ax.stairs(counts, edges, fill=True, color=GREEN, alpha=0.75)
    mean = float(np.mean(r))
    ax.axvline(mean, color=INK_COLOR, lw=1, label=f"mean {format_number(mean, 2)} {unit}")
    title = f"{sensor}, {format_kind(kind)}: in {unit}"
    ax.set(xlabel=f"residual, {unit}", ylabel="count", title=title)
    ax.set_ylim(0, 1.2 * counts.max())
    ax.legend(loc="upper right")
    caption = RESIDUAL_HISTOGRAM.format(
        rms=format_number(root_mean_square(r)),
        unit=unit,
        meaning=KIND_DESCRIPTIONS.get(kind, "residuals"),
    )
    label = f"Residuals of {sensor} {format_kind(kind)} in {unit}"
    return figure_encoding.finish_drawing(fig, f"si-{sensor}-{kind}", label=label, caption=caption)


def draw_pixel_residuals(sensor: str, kind: str, inliers: Columns) -> Drawing:
    """Draw the residuals (u, v) of a camera as points."""
    uv = inliers["value"]
    limit = np.abs(uv).max() * 1.05 + 1e-12
    fig, ax = create_figure(height=compute_figure_height(0.9))
    ax.plot(*uv.T, ".", ms=2.5, mew=0, alpha=0.6, color=GREEN, rasterized=True)
    mean = uv.mean(0)
    ax.plot(*mean, "+", ms=9, mew=1.4, color=INK_COLOR, label="mean")
    ax.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", adjustable="box")
    title = f"{sensor}, {format_kind(kind)}: in px"
    ax.set(xlabel="u: right, px", ylabel="v: down, px", title=title)
    ax.legend(loc="upper right")
    decimals = choose_decimals((root_mean_square(uv) or 0.0) / 10)
    caption = PIXEL_RESIDUALS.format(
        rms=format_number(root_mean_square(np.linalg.norm(uv, axis=1))),
        u=format_decimals(mean[0], decimals),
        v=format_decimals(mean[1], decimals),
    )
    label = f"Residuals of {sensor} {format_kind(kind)} in pixels"
    return figure_encoding.finish_drawing(fig, f"px-{sensor}-{kind}", label=label, caption=caption)


def draw_placement_rms(sensor: str, inliers: dict[str, Columns]) -> Drawing:
    """Draw the rms of each placement, one mark per kind."""
    fig, ax = create_figure()
    rows_by_kind = {kind: rms_by_placement(columns) for kind, columns in inliers.items()}
    keys = sorted({row[:2] for rows in rows_by_kind.values() for row in rows})
    position = {key: i for i, key in enumerate(keys)}
    top = 1.5
    for (kind, rows), color in zip(rows_by_kind.items(), COLOR_CYCLE, strict=False):
        rms = [value for _, _, value in rows]
        x = [position[row[:2]] for row in rows]
        ax.plot(x, rms, "o", ms=4, color=color, label=format_kind(kind))
        top = max(top, *rms)
    ax.axhline(1, color=MUTED_COLOR, lw=0.8, ls="--")
    step = -(-len(keys) // MAX_TICKS)
    ax.xaxis.set_ticks(range(0, len(keys), step), [str(p) for _, p in keys[::step]])
    for i in (i for i in range(1, len(keys)) if keys[i][0] != keys[i - 1][0]):
        ax.axvline(i - 0.5, color=MUTED_COLOR, lw=0.8)
    ax.set(xlabel="placement", ylabel="rms residual / σ", ylim=(0, top * 1.25))
    ax.set_title(f"{sensor}: by placement")
    ax.legend(loc="upper right", ncols=3)
    has_sessions = len({session for session, _ in keys}) > 1
    return figure_encoding.finish_drawing(
        fig,
        f"placements-{sensor}",
        label=f"Residuals of {sensor} by placement",
        caption=PLACEMENT_RMS + (PLACEMENT_RMS_SESSIONS if has_sessions else ""),
    )
