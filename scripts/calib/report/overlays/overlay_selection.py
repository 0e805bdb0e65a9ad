"""Targets as a sensor saw them against where guess and solution put them: the worst first."""

from calib.io.parquet_tables import select_rows
from calib.report.overlays.camera_overlay import draw_camera_overlay
from calib.report.overlays.lidar_overlay import draw_lidar_overlay
from calib.report.sections.residual_tables import residuals_by_kind, score_views
from calib.views.view_payloads import read_view_payloads

DRAW_OVERLAY_BY_KIND = {"camera": draw_camera_overlay, "lidar": draw_lidar_overlay}


def draw_worst_overlays(run, sensor):
    """Overlays of one sensor: the worst view of the worst placements, then views without a find."""
    return draw_overlays(
        run, sensor, select_overlay_views(run, sensor, run.options["report"]["max_overlays"])
    )


def draw_typical_overlay(run, sensor):
    """The overlay of the view in the middle of those that of_sensor does not show, by its
    residuals, in a list; none where all are shown."""
    most = run.options["report"]["max_overlays"]
    worst = select_overlay_views(run, sensor, most)
    left = [view for view in rank_placement_views(run, sensor) if view not in worst]
    middle = left[len(left) // 2 : len(left) // 2 + 1]
    return draw_overlays(run, sensor, middle if most else [])


def draw_overlays(run, sensor, views):
    """{head, drawing} of views [(session, view, score or None)]."""
    read = {
        session: read_view_payloads(stream.views_path, [v for s, v, _ in views if s == session])
        for session, stream in select_sensor_streams(run, sensor).items()
    }
    draw = DRAW_OVERLAY_BY_KIND[run.sensors[sensor]["kind"]]
    rows = residuals_by_kind(run, sensor)
    out = []
    for session, view, score in views:
        here = {k: _select_view_rows(c, session, view) for k, c in rows.items()}
        drawing = draw(run, sensor, session, read[session][view], here)
        out.append(
            {"head": describe_overlay_view(run, sensor, session, view, score), "drawing": drawing}
        )
    return out


def select_sensor_streams(run, sensor):
    """{session: Stream} of the sessions that use a sensor."""
    return {n: s.streams[sensor] for n, s in run.sessions.items() if sensor in s.streams}


def select_overlay_views(run, sensor, max_views):
    """[(session, view, score or None)]: one per placement, the worst first, then some failures."""
    used = _order_targets_first(run, sensor, rank_placement_views(run, sensor))
    failed = [
        (session, view, None)
        for session, stream in select_sensor_streams(run, sensor).items()
        for view, status in sorted(stream.status_by_view.items())
        if not status.ok
    ]
    n_failed = min(len(failed), max(max_views // 3, max_views - len(used)))
    shown = sorted(used[: max_views - n_failed], key=lambda r: (-r[2], r[:2]))
    return shown + failed[:n_failed]


def rank_placement_views(run, sensor):
    """[(session, view, score)] of the worst view of every placement, the worst first."""
    scores = score_views(residuals_by_kind(run, sensor))
    worst = {}
    for (session, view), (placement, value, _) in scores.items():
        key = session, placement
        if key not in worst or value > worst[key][2]:
            worst[key] = session, view, value
    return sorted(worst.values(), key=lambda r: (-r[2], r[:2]))


def _order_targets_first(run, sensor, views):
    """Views, worst first, with the worst of every target before all others."""
    seen, first, rest = set(), [], []
    for session, view, value in views:
        target = run.sessions[session].streams[sensor].views["target"][view]
        (rest if target in seen else first).append((session, view, value))
        seen.add(target)
    return first + rest


def describe_overlay_view(run, sensor, session, view, score):
    """What a view is, in one line, and for a failure expected against found."""
    stream = run.sessions[session].streams[sensor]
    target, placement = stream.views["target"][view], int(stream.views["placement"][view])
    line = f"{session}, view {view}: {target}, placement {placement}"
    if score is not None:
        return {"line": f"{line}; rms {score:.2f} σ", "status": None}
    return {"line": f"{line}; nothing found", "status": stream.status_by_view[view]}


def _select_view_rows(columns, session, view):
    return select_rows(columns, (columns["session"] == session) & (columns["view"] == view))
