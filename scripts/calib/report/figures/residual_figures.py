"""The report's plots of residuals, and the timeline of a session."""

import numpy as np

from calib.report import number_format
from calib.report.figures import captions, svg_plots
from calib.report.figures.svg_plots import BLUE, CYCLE, GREEN, GREY, INK, MUTED, ORANGE, RED
from calib.report.sections import frame_losses, residual_tables

NS = 1e9
BINS = 41
FEW = 5  # groups of fewer residuals are not drawn
CELLS = (8, 6)
QUANTILES = (0.16, 0.5, 0.84)
TICKS = 12
ONE_TO_ONE = dict(angles="xy", scale_units="xy", scale=1)
STROKES = ONE_TO_ONE | dict(width=0.002, color=GREY, alpha=0.8)
STROKES |= dict(headwidth=0, headlength=0, headaxislength=0)
ARROWS = ONE_TO_ONE | dict(width=0.006, color=RED)
ARROWS |= dict(headwidth=3, headlength=3, headaxislength=3)


def of_sensor(run, sensor):
    """The residual plots of one sensor, in reading order; none without a member."""
    kinds = {k: residual_tables.members(c) for k, c in residual_tables.of(run, sensor).items()}
    kinds = {k: c for k, c in kinds.items() if len(c["weight"])}
    out = []
    for kind, columns in kinds.items():
        out.append(sigmas(sensor, kind, columns))
        plane = residual_tables.components(columns).shape[1] == 2
        out.append((pixels if plane else lengths)(sensor, kind, columns))
    if kinds:
        out.append(placements(sensor, kinds))
    if main := residual_tables.lengths(kinds):
        out += surface(sensor, main)
    elif kinds:
        out += lens(sensor, kinds.values())
    in_image = [c for c in kinds.values() if residual_tables.components(c).shape[1] == 2]
    return out + ([vectors(run, sensor, in_image)] if in_image else [])


def sigmas(sensor, kind, columns):
    """Histogram of the residuals over their σ against N(0, 1)."""
    r = residual_tables.normalised(columns).ravel()
    limit = max(4.0, np.ceil(np.abs(r).max()))
    edges = np.linspace(-limit, limit, BINS)
    fig, ax = svg_plots.figure()
    ax.stairs(np.histogram(r, edges)[0], edges, fill=True, color=BLUE, alpha=0.75)
    signed = residual_tables.signed(r)
    if signed:
        x = np.linspace(-limit, limit, 200)
        normal = np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi) * len(r) * (edges[1] - edges[0])
        ax.plot(x, normal, color=ORANGE, lw=1.4, label="N(0, 1)")
        ax.legend(loc="upper right")
    for side in (-residual_tables.BEYOND, residual_tables.BEYOND):
        ax.axvline(side, color=MUTED, lw=0.7, ls=":")
    ax.set(xlabel="residual / σ", ylabel="count", title=f"{sensor}, {kind}: in units of σ")
    out, expected = residual_tables.beyond(r)
    caption = captions.SIGMA.format(
        n=number_format.count(len(r)),
        rms=number_format.fixed(residual_tables.rms(r), 2),
        out=number_format.count(out),
        expected=f"a normal would have {number_format.number(expected, 2)}. " if signed else "",
        good=captions.SIGMA_GOOD[kind if kind == "edge" else "signed" if signed else "length"],
    )
    label = f"Residuals of {sensor} {kind} over sigma"
    return svg_plots.drawing(fig, f"sigma-{sensor}-{kind}", label, caption)


def lengths(sensor, kind, columns):
    """Histogram of residuals of one component in mm, degrees or pixels."""
    unit, scale = residual_tables.unit(kind)
    r = residual_tables.components(columns).ravel() * scale
    limit = np.abs(r).max() * 1.02 + 1e-12
    low = -limit if residual_tables.signed(r) else 0.0
    fig, ax = svg_plots.figure()
    counts, edges = np.histogram(r, np.linspace(low, limit, BINS))
    ax.stairs(counts, edges, fill=True, color=GREEN, alpha=0.75)
    ax.axvline(
        np.mean(r), color=INK, lw=1, label=f"mean {number_format.number(np.mean(r), 2)} {unit}"
    )
    ax.set(xlabel=f"residual, {unit}", ylabel="count", title=f"{sensor}, {kind}: in {unit}")
    ax.set_ylim(0, 1.2 * counts.max())
    ax.legend(loc="upper right")
    meaning = residual_tables.MEANING.get(kind, "residuals")
    size = number_format.number(residual_tables.rms(r))
    caption = captions.LENGTH.format(rms=size, unit=unit, meaning=meaning)
    label = f"Residuals of {sensor} {kind} in {unit}"
    return svg_plots.drawing(fig, f"si-{sensor}-{kind}", label, caption)


def pixels(sensor, kind, columns):
    """Residuals (u, v) of a camera as a cloud."""
    uv = columns["value"]
    limit = np.abs(uv).max() * 1.05 + 1e-12
    fig, ax = svg_plots.figure(height=svg_plots.height_for(0.9))
    ax.plot(*uv.T, ".", ms=2.5, mew=0, alpha=0.6, color=GREEN, rasterized=True)
    mean, digits = uv.mean(0), number_format.places(residual_tables.rms(uv) / 10)
    ax.plot(*mean, "+", ms=9, mew=1.4, color=INK, label="mean")
    ax.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", adjustable="box")
    ax.set(xlabel="u: right, px", ylabel="v: down, px", title=f"{sensor}, {kind}: in px")
    ax.legend(loc="upper right")
    size = number_format.number(residual_tables.rms(np.linalg.norm(uv, axis=1)))
    u, v = (number_format.fixed(m, digits) for m in mean)
    caption = captions.PIXEL.format(rms=size, u=u, v=v)
    label = f"Residuals of {sensor} {kind} in pixels"
    return svg_plots.drawing(fig, f"px-{sensor}-{kind}", label, caption)


def placements(sensor, kinds):
    """Rms per placement, one mark per kind."""
    fig, ax = svg_plots.figure()
    rows = {k: residual_tables.by_placement(c) for k, c in kinds.items()}
    keys = sorted({r[:2] for group in rows.values() for r in group})
    at = {key: i for i, key in enumerate(keys)}
    top = 1.5
    for (kind, group), colour in zip(rows.items(), CYCLE, strict=False):
        x, y = [at[r[:2]] for r in group], [r[3] for r in group]
        ax.plot(x, y, "o", ms=4, color=colour, label=kind)
        top = max(top, *y)
    ax.axhline(1, color=MUTED, lw=0.8, ls="--")
    step = -(-len(keys) // TICKS)
    ax.xaxis.set_ticks(range(0, len(keys), step), [str(p) for _, p in keys[::step]])
    for i in (i for i in range(1, len(keys)) if keys[i][0] != keys[i - 1][0]):
        ax.axvline(i - 0.5, color=MUTED, lw=0.8)
    ax.set(xlabel="placement", ylabel="rms residual / σ", ylim=(0, top * 1.25))
    ax.set_title(f"{sensor}: by placement")
    ax.legend(loc="upper right", ncols=3)
    several = len({session for session, _ in keys}) > 1
    caption = captions.PLACEMENT + (captions.PLACEMENT_SESSIONS if several else "")
    label = f"Residuals of {sensor} by placement"
    return svg_plots.drawing(fig, f"placements-{sensor}", label, caption)


def vectors(run, sensor, parts):
    """Where in the image the residuals point: each of them, and the mean of each cell."""
    uv = np.concatenate([c["measured"][:, :2] for c in parts])
    value = np.concatenate([c["value"] for c in parts])
    width, height = run.options["sensors"][sensor]["size_px"]
    centre, mean, sigma = cells(uv, value, width, height)
    longest = np.linalg.norm(mean, axis=1).max(initial=0.0)
    large = np.quantile(np.linalg.norm(value, axis=1), 0.9)
    wide = 1.4 * svg_plots.WIDTH
    gain = number_format.nice(width / 9 / max(large, 1e-6))
    mean_gain = number_format.nice(width / 9 / max(longest, 1e-6)) if len(mean) else gain
    fig, ax = svg_plots.figure(wide, svg_plots.height_for(height / width, wide))
    ax.quiver(*uv.T, *(value * gain).T, rasterized=len(uv) > 400, **STROKES)
    ax.quiver(*centre.T, *(mean * mean_gain).T, **ARROWS)
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    ax.set(xlabel="u, px", ylabel="v, px", title=f"{sensor}: over the image")
    beyond = int(np.sum(np.linalg.norm(mean, axis=1) > 3 * sigma))
    numbers = dict(
        gain=number_format.number(gain), mean_gain=number_format.number(mean_gain), few=FEW
    )
    numbers |= dict(longest=number_format.number(longest, 2), beyond=beyond, cells=len(mean))
    caption = captions.VECTOR.format(**numbers)
    label = f"Residual vectors of {sensor} over the image"
    return svg_plots.drawing(fig, f"vectors-{sensor}", label, caption, span=2)


def cells(uv, value, width, height):
    """Centres (k, 2), mean residuals (k, 2) and their σ (k,) of image cells with enough of them."""
    columns, rows = CELLS
    i = np.clip((uv[:, 0] + 0.5) * columns / width, 0, columns - 1).astype(int)
    j = np.clip((uv[:, 1] + 0.5) * rows / height, 0, rows - 1).astype(int)
    out = []
    for cell in np.unique(np.column_stack([i, j]), axis=0):
        inside = (i == cell[0]) & (j == cell[1])
        if inside.sum() >= FEW:
            spread = np.sqrt(value[inside].var(0).mean() / inside.sum())
            middle = (cell + 0.5) * [width / columns, height / rows] - 0.5
            out.append([*middle, *value[inside].mean(0), spread])
    out = np.reshape(out, (-1, 5))
    return out[:, :2], out[:, 2:4], out[:, 4]


def surface(sensor, columns):
    """Residuals of a lidar's returns by ring, range and angle of incidence."""
    d, r = columns["value"][:, 0] * 1e3, columns["value"][:, 0] / columns["sigma"]
    ring = np.asarray(columns["index"])
    cosine = np.asarray(columns["cosine"])
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    rings = [(k, d[ring == k]) for k in np.unique(ring[ring >= 0])]
    ranges = _binned(np.asarray(columns["range"]), r)
    # A comparison of points with points knows no incidence and says 0.
    angles = _binned(angle, r) if cosine.any() else []
    mm, over = ("residual, mm", None), ("residual / σ", (-1, 1))
    plans = (
        ("ring", rings, "ring (beam)", mm, captions.RING),
        ("range", ranges, "range, m", over, captions.RANGE),
        ("incidence", angles, "angle of incidence, °", over, captions.INCIDENCE),
    )
    return [_groups(sensor, *plan) for plan in plans if plan[1]]


def lens(sensor, parts):
    """Residuals of a camera by range and angle of incidence, all kinds together."""
    r = [residual_tables.normalised(c) for c in parts]
    value = np.concatenate([v.ravel() for v in r])

    def spread(name):
        return np.concatenate(
            [np.repeat(c[name], v.shape[1]) for c, v in zip(parts, r, strict=True)]
        )

    angle = np.degrees(np.arccos(np.clip(spread("cosine"), -1, 1)))
    over = ("residual / σ", (-1, 1))
    out = [_groups(sensor, "range", _binned(spread("range"), value), "range, m", over,
                   captions.RANGE)]  # fmt: skip
    if spread("cosine").any():
        out.append(_groups(sensor, "incidence", _binned(angle, value), "angle of incidence, °",
                           over, captions.INCIDENCE_CAMERA))  # fmt: skip
    return out


def _binned(x, r, bins=12):
    """[(middle, residuals)] of equal bins of x."""
    edges = np.linspace(x.min(), x.max() + 1e-9, bins + 1)
    at = np.digitize(x, edges) - 1
    return [((edges[k] + edges[k + 1]) / 2, r[at == k]) for k in range(bins)]


def _groups(sensor, what, groups, xlabel, axis, caption):
    ylabel, band = axis
    fig, ax = svg_plots.figure()
    shown = [(x, np.quantile(v, QUANTILES)) for x, v in groups if len(v) >= FEW]
    if band:
        ax.axhspan(*band, color=GREY, alpha=0.15, lw=0)
    ax.axhline(0, color=MUTED, lw=0.8)
    if shown:
        x, q = np.array([x for x, _ in shown]), np.array([q for _, q in shown]).T
        ax.errorbar(x, q[1], [q[1] - q[0], q[2] - q[1]], fmt="o", ms=3.5, lw=1.2, color=BLUE)
    ax.set(xlabel=xlabel, ylabel=ylabel, title=f"{sensor}: by {what}")
    return svg_plots.drawing(fig, f"{what}-{sensor}", f"Residuals of {sensor} by {what}", caption)


def timeline(run, session):
    """Still intervals of every target and the frames taken from them; None without any."""
    still = frame_losses.still(run, session)
    streams = run.sessions[session].streams
    every = [np.asarray(s.views["t"], np.int64) for s in streams.values()]
    every = np.concatenate([*every, *(v.ravel() for v in still.values()), np.zeros(0, np.int64)])
    rows = [(t, s) for t in still for s in (None, *streams)]
    if not rows or not len(every):
        return None
    zero, last = every.min(), every.max()
    names = [f"{t} still" if s is None else s for t, s in rows]
    left = 0.25 + 0.062 * max(map(len, names))
    fig, ax = svg_plots.figure(width=svg_plots.WIDE, height=0.75 + 0.22 * len(rows), left=left)
    for y, (target, sensor) in enumerate(rows):
        if sensor is None:
            spans = [((a - zero) / NS, (b - a) / NS) for a, b in still[target]]
            ax.broken_barh(spans, (y - 0.3, 0.6), color=BLUE, alpha=0.55, lw=0)
        else:
            _frames(ax, y, run, session, sensor, target, zero)
    ax.yaxis.set_ticks(range(len(rows)), names)
    ax.set(ylim=(len(rows) - 0.5, -0.5), xlabel="time from the first message shown, s")
    ax.set_xlim(0, max((last - zero) / NS, 1e-3))
    ax.grid(axis="y", visible=False)
    label = f"Placements and frames of session {session}"
    return svg_plots.drawing(fig, f"timeline-{session}", label, captions.TIMELINE, span=0)


def _frames(ax, y, run, session, sensor, target, zero):
    """Strokes for the frames of one sensor and target, by what became of them."""
    views = run.sessions[session].streams[sensor].views
    rows = np.asarray(views["target"], str) == target
    kept = np.asarray(views["kept"], bool)
    used = np.isin(views["view"], list(run.used_views.get((session, sensor), ())))
    t = (np.asarray(views["t"], np.int64) - zero) / NS
    for mask, colour, half in (
        (rows & ~kept, GREY, 0.12),
        (rows & kept & ~used, ORANGE, 0.36),
        (rows & kept & used, GREEN, 0.36),
    ):
        # One path with gaps: thousands of strokes stay small.
        x = np.column_stack([t[mask], t[mask], np.full(mask.sum(), np.nan)]).ravel()
        ax.plot(x, np.tile([y - half, y + half, np.nan], mask.sum()), color=colour, lw=0.8)
