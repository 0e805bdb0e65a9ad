"""Timeline of a session: still intervals of the targets, and the frames taken from them."""

import numpy as np
from matplotlib.axes import Axes

from calib.geometry.units import NS_PER_S
from calib.report.data.run_data import Columns, ReportRun
from calib.report.figures import figure_encoding
from calib.report.figures.captions import SESSION_TIMELINE
from calib.report.figures.figure_encoding import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PAGE_WIDTH_IN,
    Drawing,
    create_figure,
)
from calib.report.sections.frames import list_still_intervals

TALL_STROKE, SHORT_STROKE = 0.36, 0.12  # half of the height, in rows


def draw_session_timeline(run: ReportRun, session: str) -> Drawing | None:
    """Draw the timeline of one session; None without a still interval and without a frame."""
    intervals = list_still_intervals(run.sessions[session])
    streams = run.sessions[session].streams
    stamps_ns = np.concatenate(
        [
            *(np.asarray(s.views["stamp_ns"], np.int64) for s in streams.values()),
            *(span.ravel() for span in intervals.values()),
            np.zeros(0, np.int64),
        ]
    )
    rows = [(target, sensor) for target in intervals for sensor in (None, *streams)]
    if not rows or not len(stamps_ns):
        return None
    start_ns, end_ns = stamps_ns.min(), stamps_ns.max()
    labels = [f"{target} still" if sensor is None else sensor for target, sensor in rows]
    left = 0.25 + 0.062 * max(map(len, labels))
    fig, ax = create_figure(width=PAGE_WIDTH_IN, height=0.75 + 0.22 * len(rows), left=left)
    for y, (target, sensor) in enumerate(rows):
        if sensor is None:
            starts, durations = intervals[target][:, 0] - start_ns, np.diff(intervals[target])[:, 0]
            spans = list(zip(starts / NS_PER_S, durations / NS_PER_S, strict=True))
            ax.broken_barh(spans, (y - 0.3, 0.6), color=BLUE, alpha=0.55, lw=0)
        else:
            used = run.used_views_by_stream.get((session, sensor), set())
            _plot_frame_strokes(
                ax, y, _select_target(streams[sensor].views, target, start_ns), used
            )
    ax.yaxis.set_ticks(range(len(rows)), labels)
    ax.set(ylim=(len(rows) - 0.5, -0.5), xlabel="time from the first message shown, s")
    ax.set_xlim(0, max((end_ns - start_ns) / NS_PER_S, 1e-3))
    ax.grid(axis="y", visible=False)
    return figure_encoding.finish_drawing(
        fig,
        f"timeline-{session}",
        label=f"Placements and frames of session {session}",
        caption=SESSION_TIMELINE,
        column_span=0,
    )


def _select_target(views: Columns, target: str, start_ns: int) -> Columns:
    """Return time, s, number and kept of the views of one target."""
    rows = np.asarray(views["target"], str) == target
    return {
        "time_s": (np.asarray(views["stamp_ns"], np.int64)[rows] - start_ns) / NS_PER_S,
        "view": np.asarray(views["view"])[rows],
        "kept": np.asarray(views["kept"], bool)[rows],
    }


def _plot_frame_strokes(ax: Axes, y: float, views: Columns, used_views: set[int]) -> None:
    """Plot a stroke per view in row y: not kept, kept but not used, used."""
    is_kept, is_used = views["kept"], np.isin(views["view"], list(used_views))
    for mask, color, half in (
        (~is_kept, GREY, SHORT_STROKE),
        (is_kept & ~is_used, ORANGE, TALL_STROKE),
        (is_kept & is_used, GREEN, TALL_STROKE),
    ):
        # One path with gaps: thousands of strokes stay small.
        t, n = views["time_s"][mask], int(mask.sum())
        x = np.column_stack([t, t, np.full(n, np.nan)]).ravel()
        ax.plot(x, np.tile([y - half, y + half, np.nan], n), color=color, lw=0.8)
