"""Selects the views of a sensor whose overlays are drawn: the worst first, and a typical one."""

from typing import Any, NamedTuple, Protocol

from calib.io.parquet_tables import select_rows
from calib.report.data.run_data import Columns, ReportRun, ReportStream
from calib.report.figures.figure_encoding import Drawing
from calib.report.overlays.camera_overlay import draw_camera_overlay
from calib.report.overlays.lidar_overlay import draw_lidar_overlay
from calib.report.sections.residuals import residuals_by_kind, score_views
from calib.views.view_payloads import read_view_payloads


class ScoredView(NamedTuple):
    """A view and the rms of its residuals in σ; None if the target was not found."""

    session: str
    view: int
    score: float | None


class DrawOverlay(Protocol):
    """Draws one view with its payload; residuals: of the view, by kind."""

    def __call__(
        self,
        run: ReportRun,
        sensor: str,
        session: str,
        view: dict[str, Any],
        residuals: dict[str, Columns],
    ) -> Drawing:
        """Return the drawing."""


DRAW_OVERLAY_BY_KIND: dict[str, DrawOverlay] = {
    "camera": draw_camera_overlay,
    "lidar": draw_lidar_overlay,
}


def draw_worst_overlays(run: ReportRun, sensor: str) -> list[dict[str, Any]]:
    """Draw the worst view of the worst placements, then views in which nothing was found."""
    views = select_overlay_views(run, sensor, run.options["report"]["max_overlays"])
    return draw_overlays(run, sensor, views)


def draw_typical_overlay(run: ReportRun, sensor: str) -> list[dict[str, Any]]:
    """Draw the median view of those that draw_worst_overlays leaves out; empty without any."""
    max_views = run.options["report"]["max_overlays"]
    worst = select_overlay_views(run, sensor, max_views)
    others = [view for view in rank_placement_views(run, sensor) if view not in worst]
    typical = others[len(others) // 2 : len(others) // 2 + 1]
    return draw_overlays(run, sensor, typical if max_views else [])


def draw_overlays(run: ReportRun, sensor: str, views: list[ScoredView]) -> list[dict[str, Any]]:
    """Return {line, status, drawing} of views."""
    payloads = {
        session: read_view_payloads(
            stream.views_path, [v.view for v in views if v.session == session]
        )
        for session, stream in select_sensor_streams(run, sensor).items()
    }
    draw = DRAW_OVERLAY_BY_KIND[run.sensors[sensor]["kind"]]
    overlays = []
    for view in views:
        residuals = {
            kind: _select_view_rows(columns, view)
            for kind, columns in residuals_by_kind(run, sensor).items()
        }
        payload = payloads[view.session][view.view]
        drawing = draw(run, sensor, view.session, payload, residuals)
        overlays.append(describe_overlay_view(run, sensor, view) | {"drawing": drawing})
    return overlays


def select_sensor_streams(run: ReportRun, sensor: str) -> dict[str, ReportStream]:
    """Return the streams of a sensor by session."""
    return {n: s.streams[sensor] for n, s in run.sessions.items() if sensor in s.streams}


def select_overlay_views(run: ReportRun, sensor: str, max_views: int) -> list[ScoredView]:
    """Return the worst view of each placement, the worst first, then some failures."""
    used = _order_targets_first(run, sensor, rank_placement_views(run, sensor))
    failed = [
        ScoredView(session, view, None)
        for session, stream in select_sensor_streams(run, sensor).items()
        for view, status in sorted(stream.status_by_view.items())
        if not status.ok
    ]
    n_failed = min(len(failed), max(max_views // 3, max_views - len(used)))
    return _sort_worst_first(used[: max_views - n_failed]) + failed[:n_failed]


def rank_placement_views(run: ReportRun, sensor: str) -> list[ScoredView]:
    """Return the worst view of each placement, the worst first."""
    worst: dict[tuple[str, int], ScoredView] = {}
    scores = score_views(residuals_by_kind(run, sensor))
    for (session, view), (placement, score, _) in scores.items():
        key = session, placement
        if key not in worst or score > (worst[key].score or 0.0):
            worst[key] = ScoredView(session, view, score)
    return _sort_worst_first(list(worst.values()))


def _sort_worst_first(views: list[ScoredView]) -> list[ScoredView]:
    return sorted(views, key=lambda v: (-(v.score or 0.0), v.session, v.view))


def _order_targets_first(run: ReportRun, sensor: str, views: list[ScoredView]) -> list[ScoredView]:
    """Put the worst view of each target before all others; views: the worst first."""
    targets: set[str] = set()
    first: list[ScoredView] = []
    others: list[ScoredView] = []
    for view in views:
        target = run.sessions[view.session].streams[sensor].views["target"][view.view]
        (others if target in targets else first).append(view)
        targets.add(target)
    return first + others


def describe_overlay_view(run: ReportRun, sensor: str, view: ScoredView) -> dict[str, Any]:
    """Return {line, status}: what a view shows, and the status of a failure."""
    stream = run.sessions[view.session].streams[sensor]
    target = stream.views["target"][view.view]
    placement = int(stream.views["placement"][view.view])
    line = f"{view.session}, view {view.view}: {target}, placement {placement}"
    if view.score is not None:
        return {"line": f"{line}; rms {view.score:.2f} σ", "status": None}
    return {"line": f"{line}; nothing found", "status": stream.status_by_view[view.view]}


def _select_view_rows(columns: Columns, view: ScoredView) -> Columns:
    rows = (columns["session"] == view.session) & (columns["view"] == view.view)
    return select_rows(columns, rows)
