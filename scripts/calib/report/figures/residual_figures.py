"""The report's plots of residuals, and the timeline of a session."""

import numpy as np

from calib.geometry.units import NS_PER_S
from calib.report.figures import svg_plots
from calib.report.figures.captions import (
    CAMERA_RESIDUALS_BY_INCIDENCE,
    LIDAR_RESIDUALS_BY_INCIDENCE,
    PIXEL_RESIDUALS,
    PLACEMENT_RMS,
    PLACEMENT_RMS_SESSIONS,
    RESIDUAL_HISTOGRAM,
    RESIDUAL_VECTORS,
    RESIDUALS_BY_RANGE,
    RESIDUALS_BY_RING,
    SESSION_TIMELINE,
    STANDARDIZED_HISTOGRAM,
    STANDARDIZED_HISTOGRAM_GOOD,
)
from calib.report.figures.svg_plots import (
    BLUE,
    COLOR_CYCLE,
    FIGURE_WIDTH_IN,
    GREEN,
    GREY,
    INK_COLOR,
    MUTED_COLOR,
    ORANGE,
    PAGE_WIDTH_IN,
    RED,
    compute_figure_height,
    create_figure,
)
from calib.report.number_format import (
    choose_decimals,
    floor_to_nice_number,
    format_count,
    format_decimals,
    format_number,
)
from calib.report.sections.frame_losses import list_still_intervals
from calib.report.sections.residual_tables import (
    KIND_DESCRIPTIONS,
    TAIL_LIMIT_SIGMA,
    count_tail_residuals,
    has_negative_residuals,
    printed_unit,
    residual_components,
    residuals_by_kind,
    rms_by_placement,
    root_mean_square,
    select_inlier_rows,
    select_main_lidar_residuals,
    standardize_residuals,
)

N_BINS = 41
MIN_GROUP_SIZE = 5  # groups of fewer residuals are not drawn
N_IMAGE_CELLS = (8, 6)
BAR_QUANTILES = (0.16, 0.5, 0.84)
MAX_TICKS = 12
QUIVER_TO_SCALE = dict(angles="xy", scale_units="xy", scale=1)
STROKE_STYLE = QUIVER_TO_SCALE | dict(width=0.002, color=GREY, alpha=0.8)
STROKE_STYLE |= dict(headwidth=0, headlength=0, headaxislength=0)
ARROW_STYLE = QUIVER_TO_SCALE | dict(width=0.006, color=RED)
ARROW_STYLE |= dict(headwidth=3, headlength=3, headaxislength=3)


def draw_residual_figures(run, sensor):
    """The residual plots of one sensor, in reading order; none without a member."""
    kinds = {k: select_inlier_rows(c) for k, c in residuals_by_kind(run, sensor).items()}
    kinds = {k: c for k, c in kinds.items() if len(c["weight"])}
    out = []
    for kind, columns in kinds.items():
        out.append(draw_standardized_histogram(sensor, kind, columns))
        plane = residual_components(columns).shape[1] == 2
        out.append(
            (draw_pixel_residuals if plane else draw_residual_histogram)(sensor, kind, columns)
        )
    if kinds:
        out.append(draw_placement_rms(sensor, kinds))
    if main := select_main_lidar_residuals(kinds):
        out += draw_lidar_dependences(sensor, main)
    elif kinds:
        out += draw_camera_dependences(sensor, kinds.values())
    in_image = [c for c in kinds.values() if residual_components(c).shape[1] == 2]
    return out + ([draw_residual_vectors(run, sensor, in_image)] if in_image else [])


def draw_standardized_histogram(sensor, kind, columns):
    """Histogram of the residuals over their σ against N(0, 1)."""
    r = standardize_residuals(columns).ravel()
    limit = max(4.0, np.ceil(np.abs(r).max()))
    edges = np.linspace(-limit, limit, N_BINS)
    fig, ax = create_figure()
    ax.stairs(np.histogram(r, edges)[0], edges, fill=True, color=BLUE, alpha=0.75)
    signed = has_negative_residuals(r)
    if signed:
        x = np.linspace(-limit, limit, 200)
        normal = np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi) * len(r) * (edges[1] - edges[0])
        ax.plot(x, normal, color=ORANGE, lw=1.4, label="N(0, 1)")
        ax.legend(loc="upper right")
    for side in (-TAIL_LIMIT_SIGMA, TAIL_LIMIT_SIGMA):
        ax.axvline(side, color=MUTED_COLOR, lw=0.7, ls=":")
    ax.set(xlabel="residual / σ", ylabel="count", title=f"{sensor}, {kind}: in units of σ")
    out, expected = count_tail_residuals(r)
    caption = STANDARDIZED_HISTOGRAM.format(
        n=format_count(len(r)),
        rms=format_decimals(root_mean_square(r), 2),
        out=format_count(out),
        expected=f"a normal would have {format_number(expected, 2)}. " if signed else "",
        good=STANDARDIZED_HISTOGRAM_GOOD[
            kind if kind == "board_outline" else "signed" if signed else "length"
        ],
    )
    label = f"Residuals of {sensor} {kind} over sigma"
    return svg_plots.finish_drawing(fig, f"sigma-{sensor}-{kind}", label, caption)


def draw_residual_histogram(sensor, kind, columns):
    """Histogram of residuals of one component in mm, degrees or pixels."""
    unit, scale = printed_unit(kind)
    r = residual_components(columns).ravel() * scale
    limit = np.abs(r).max() * 1.02 + 1e-12
    low = -limit if has_negative_residuals(r) else 0.0
    fig, ax = create_figure()
    counts, edges = np.histogram(r, np.linspace(low, limit, N_BINS))
    ax.stairs(counts, edges, fill=True, color=GREEN, alpha=0.75)
    ax.axvline(
        np.mean(r), color=INK_COLOR, lw=1, label=f"mean {format_number(np.mean(r), 2)} {unit}"
    )
    ax.set(xlabel=f"residual, {unit}", ylabel="count", title=f"{sensor}, {kind}: in {unit}")
    ax.set_ylim(0, 1.2 * counts.max())
    ax.legend(loc="upper right")
    meaning = KIND_DESCRIPTIONS.get(kind, "residuals")
    size = format_number(root_mean_square(r))
    caption = RESIDUAL_HISTOGRAM.format(rms=size, unit=unit, meaning=meaning)
    label = f"Residuals of {sensor} {kind} in {unit}"
    return svg_plots.finish_drawing(fig, f"si-{sensor}-{kind}", label, caption)


def draw_pixel_residuals(sensor, kind, columns):
    """Residuals (u, v) of a camera as a cloud."""
    uv = columns["value"]
    limit = np.abs(uv).max() * 1.05 + 1e-12
    fig, ax = create_figure(height=compute_figure_height(0.9))
    ax.plot(*uv.T, ".", ms=2.5, mew=0, alpha=0.6, color=GREEN, rasterized=True)
    mean, digits = uv.mean(0), choose_decimals(root_mean_square(uv) / 10)
    ax.plot(*mean, "+", ms=9, mew=1.4, color=INK_COLOR, label="mean")
    ax.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", adjustable="box")
    ax.set(xlabel="u: right, px", ylabel="v: down, px", title=f"{sensor}, {kind}: in px")
    ax.legend(loc="upper right")
    size = format_number(root_mean_square(np.linalg.norm(uv, axis=1)))
    u, v = (format_decimals(m, digits) for m in mean)
    caption = PIXEL_RESIDUALS.format(rms=size, u=u, v=v)
    label = f"Residuals of {sensor} {kind} in pixels"
    return svg_plots.finish_drawing(fig, f"px-{sensor}-{kind}", label, caption)


def draw_placement_rms(sensor, kinds):
    """Rms per placement, one mark per kind."""
    fig, ax = create_figure()
    rows = {k: rms_by_placement(c) for k, c in kinds.items()}
    keys = sorted({r[:2] for group in rows.values() for r in group})
    at = {key: i for i, key in enumerate(keys)}
    top = 1.5
    for (kind, group), colour in zip(rows.items(), COLOR_CYCLE, strict=False):
        x, y = [at[r[:2]] for r in group], [r[3] for r in group]
        ax.plot(x, y, "o", ms=4, color=colour, label=kind)
        top = max(top, *y)
    ax.axhline(1, color=MUTED_COLOR, lw=0.8, ls="--")
    step = -(-len(keys) // MAX_TICKS)
    ax.xaxis.set_ticks(range(0, len(keys), step), [str(p) for _, p in keys[::step]])
    for i in (i for i in range(1, len(keys)) if keys[i][0] != keys[i - 1][0]):
        ax.axvline(i - 0.5, color=MUTED_COLOR, lw=0.8)
    ax.set(xlabel="placement", ylabel="rms residual / σ", ylim=(0, top * 1.25))
    ax.set_title(f"{sensor}: by placement")
    ax.legend(loc="upper right", ncols=3)
    several = len({session for session, _ in keys}) > 1
    caption = PLACEMENT_RMS + (PLACEMENT_RMS_SESSIONS if several else "")
    label = f"Residuals of {sensor} by placement"
    return svg_plots.finish_drawing(fig, f"placements-{sensor}", label, caption)


def draw_residual_vectors(run, sensor, parts):
    """Where in the image the residuals point: each of them, and the mean of each cell."""
    uv = np.concatenate([c["measured"][:, :2] for c in parts])
    value = np.concatenate([c["value"] for c in parts])
    width, height = run.options["sensors"][sensor]["size_px"]
    centre, mean, sigma = average_image_cells(uv, value, width, height)
    longest = np.linalg.norm(mean, axis=1).max(initial=0.0)
    large = np.quantile(np.linalg.norm(value, axis=1), 0.9)
    wide = 1.4 * FIGURE_WIDTH_IN
    gain = floor_to_nice_number(width / 9 / max(large, 1e-6))
    mean_gain = floor_to_nice_number(width / 9 / max(longest, 1e-6)) if len(mean) else gain
    fig, ax = create_figure(wide, compute_figure_height(height / width, wide))
    ax.quiver(*uv.T, *(value * gain).T, rasterized=len(uv) > 400, **STROKE_STYLE)
    ax.quiver(*centre.T, *(mean * mean_gain).T, **ARROW_STYLE)
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    ax.set(xlabel="u, px", ylabel="v, px", title=f"{sensor}: over the image")
    beyond = int(np.sum(np.linalg.norm(mean, axis=1) > 3 * sigma))
    numbers = dict(gain=format_number(gain), mean_gain=format_number(mean_gain), few=MIN_GROUP_SIZE)
    numbers |= dict(longest=format_number(longest, 2), beyond=beyond, cells=len(mean))
    caption = RESIDUAL_VECTORS.format(**numbers)
    label = f"Residual vectors of {sensor} over the image"
    return svg_plots.finish_drawing(fig, f"vectors-{sensor}", label, caption, column_span=2)


def average_image_cells(uv, value, width, height):
    """Centres (k, 2), mean residuals (k, 2) and their σ (k,) of image cells with enough of them."""
    columns, rows = N_IMAGE_CELLS
    i = np.clip((uv[:, 0] + 0.5) * columns / width, 0, columns - 1).astype(int)
    j = np.clip((uv[:, 1] + 0.5) * rows / height, 0, rows - 1).astype(int)
    out = []
    for cell in np.unique(np.column_stack([i, j]), axis=0):
        inside = (i == cell[0]) & (j == cell[1])
        if inside.sum() >= MIN_GROUP_SIZE:
            spread = np.sqrt(value[inside].var(0).mean() / inside.sum())
            middle = (cell + 0.5) * [width / columns, height / rows] - 0.5
            out.append([*middle, *value[inside].mean(0), spread])
    out = np.reshape(out, (-1, 5))
    return out[:, :2], out[:, 2:4], out[:, 4]


def draw_lidar_dependences(sensor, columns):
    """Residuals of a lidar's returns by ring, range and angle of incidence."""
    d, r = columns["value"][:, 0] * 1e3, columns["value"][:, 0] / columns["sigma"]
    ring = np.asarray(columns["feature_index"])
    cosine = np.asarray(columns["cos_incidence"])
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    rings = [(k, d[ring == k]) for k in np.unique(ring[ring >= 0])]
    ranges = _split_into_bins(np.asarray(columns["range_m"]), r)
    # A comparison of points with points knows no incidence and says 0.
    angles = _split_into_bins(angle, r) if cosine.any() else []
    mm, over = ("residual, mm", None), ("residual / σ", (-1, 1))
    plans = (
        ("ring", rings, "ring (beam)", mm, RESIDUALS_BY_RING),
        ("range", ranges, "range, m", over, RESIDUALS_BY_RANGE),
        ("incidence", angles, "angle of incidence, °", over, LIDAR_RESIDUALS_BY_INCIDENCE),
    )
    return [_draw_grouped_residuals(sensor, *plan) for plan in plans if plan[1]]


def draw_camera_dependences(sensor, parts):
    """Residuals of a camera by range and angle of incidence, all kinds together."""
    r = [standardize_residuals(c) for c in parts]
    value = np.concatenate([v.ravel() for v in r])

    def spread(name):
        return np.concatenate(
            [np.repeat(c[name], v.shape[1]) for c, v in zip(parts, r, strict=True)]
        )

    angle = np.degrees(np.arccos(np.clip(spread("cos_incidence"), -1, 1)))
    over = ("residual / σ", (-1, 1))
    out = [_draw_grouped_residuals(sensor, "range", _split_into_bins(spread("range_m"), value), "range, m", over,
                   RESIDUALS_BY_RANGE)]  # fmt: skip
    if spread("cos_incidence").any():
        out.append(_draw_grouped_residuals(sensor, "incidence", _split_into_bins(angle, value), "angle of incidence, °",
                           over, CAMERA_RESIDUALS_BY_INCIDENCE))  # fmt: skip
    return out


def _split_into_bins(x, r, bins=12):
    """[(middle, residuals)] of equal bins of x."""
    edges = np.linspace(x.min(), x.max() + 1e-9, bins + 1)
    at = np.digitize(x, edges) - 1
    return [((edges[k] + edges[k + 1]) / 2, r[at == k]) for k in range(bins)]


def _draw_grouped_residuals(sensor, quantity, groups, xlabel, y_axis, caption):
    ylabel, band = y_axis
    fig, ax = create_figure()
    shown = [(x, np.quantile(v, BAR_QUANTILES)) for x, v in groups if len(v) >= MIN_GROUP_SIZE]
    if band:
        ax.axhspan(*band, color=GREY, alpha=0.15, lw=0)
    ax.axhline(0, color=MUTED_COLOR, lw=0.8)
    if shown:
        x, q = np.array([x for x, _ in shown]), np.array([q for _, q in shown]).T
        ax.errorbar(x, q[1], [q[1] - q[0], q[2] - q[1]], fmt="o", ms=3.5, lw=1.2, color=BLUE)
    ax.set(xlabel=xlabel, ylabel=ylabel, title=f"{sensor}: by {quantity}")
    return svg_plots.finish_drawing(
        fig, f"{quantity}-{sensor}", f"Residuals of {sensor} by {quantity}", caption
    )


def draw_session_timeline(run, session):
    """Still intervals of every target and the frames taken from them; None without any."""
    still = list_still_intervals(run, session)
    streams = run.sessions[session].streams
    every = [np.asarray(s.views["stamp_ns"], np.int64) for s in streams.values()]
    every = np.concatenate([*every, *(v.ravel() for v in still.values()), np.zeros(0, np.int64)])
    rows = [(t, s) for t in still for s in (None, *streams)]
    if not rows or not len(every):
        return None
    zero, last = every.min(), every.max()
    names = [f"{t} still" if s is None else s for t, s in rows]
    left = 0.25 + 0.062 * max(map(len, names))
    fig, ax = create_figure(width=PAGE_WIDTH_IN, height=0.75 + 0.22 * len(rows), left=left)
    for y, (target, sensor) in enumerate(rows):
        if sensor is None:
            spans = [((a - zero) / NS_PER_S, (b - a) / NS_PER_S) for a, b in still[target]]
            ax.broken_barh(spans, (y - 0.3, 0.6), color=BLUE, alpha=0.55, lw=0)
        else:
            _draw_frame_strokes(ax, y, run, session, sensor, target, zero)
    ax.yaxis.set_ticks(range(len(rows)), names)
    ax.set(ylim=(len(rows) - 0.5, -0.5), xlabel="time from the first message shown, s")
    ax.set_xlim(0, max((last - zero) / NS_PER_S, 1e-3))
    ax.grid(axis="y", visible=False)
    label = f"Placements and frames of session {session}"
    return svg_plots.finish_drawing(
        fig, f"timeline-{session}", label, SESSION_TIMELINE, column_span=0
    )


def _draw_frame_strokes(ax, y, run, session, sensor, target, zero):
    """Strokes for the frames of one sensor and target, by what became of them."""
    views = run.sessions[session].streams[sensor].views
    rows = np.asarray(views["target"], str) == target
    kept = np.asarray(views["kept"], bool)
    used = np.isin(views["view"], list(run.used_views_by_stream.get((session, sensor), ())))
    t = (np.asarray(views["stamp_ns"], np.int64) - zero) / NS_PER_S
    for mask, colour, half in (
        (rows & ~kept, GREY, 0.12),
        (rows & kept & ~used, ORANGE, 0.36),
        (rows & kept & used, GREEN, 0.36),
    ):
        # One path with gaps: thousands of strokes stay small.
        x = np.column_stack([t[mask], t[mask], np.full(mask.sum(), np.nan)]).ravel()
        ax.plot(x, np.tile([y - half, y + half, np.nan], mask.sum()), color=colour, lw=0.8)
