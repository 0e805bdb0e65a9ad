"""Targets as a sensor saw them against where guess and solution put them: the worst first."""

from calib.io import parquet_tables
from calib.report.overlays import camera_overlay, lidar_overlay
from calib.report.sections import residual_tables
from calib.views.view_payloads import payloads

DRAW = {"camera": camera_overlay.draw, "lidar": lidar_overlay.draw}


def of_sensor(run, sensor):
    """Overlays of one sensor: the worst view of the worst placements, then views without a find."""
    return drawn(run, sensor, choose(run, sensor, run.options["report"]["max_overlays"]))


def typical(run, sensor):
    """The overlay of the view in the middle of those that of_sensor does not show, by its
    residuals, in a list; none where all are shown."""
    most = run.options["report"]["max_overlays"]
    worst = choose(run, sensor, most)
    left = [view for view in placements(run, sensor) if view not in worst]
    middle = left[len(left) // 2 : len(left) // 2 + 1]
    return drawn(run, sensor, middle if most else [])


def drawn(run, sensor, chosen):
    """{head, drawing} of views [(session, view, score or None)]."""
    read = {
        session: payloads(stream.path, [v for s, v, _ in chosen if s == session])
        for session, stream in streams(run, sensor).items()
    }
    draw = DRAW[run.sensors[sensor]["kind"]]
    rows = residual_tables.of(run, sensor)
    out = []
    for session, view, score in chosen:
        here = {k: _of_view(c, session, view) for k, c in rows.items()}
        drawing = draw(run, sensor, session, read[session][view], here)
        out.append({"head": head(run, sensor, session, view, score), "drawing": drawing})
    return out


def streams(run, sensor):
    """{session: Stream} of the sessions that use a sensor."""
    return {n: s.streams[sensor] for n, s in run.sessions.items() if sensor in s.streams}


def choose(run, sensor, most):
    """[(session, view, score or None)]: one per placement, the worst first, then some failures."""
    used = _every_target_first(run, sensor, placements(run, sensor))
    failed = [
        (session, view, None)
        for session, stream in streams(run, sensor).items()
        for view, status in sorted(stream.outcomes.items())
        if not status.ok
    ]
    n_failed = min(len(failed), max(most // 3, most - len(used)))
    shown = sorted(used[: most - n_failed], key=lambda r: (-r[2], r[:2]))
    return shown + failed[:n_failed]


def placements(run, sensor):
    """[(session, view, score)] of the worst view of every placement, the worst first."""
    scores = residual_tables.view_scores(residual_tables.of(run, sensor))
    worst = {}
    for (session, view), (placement, value, _) in scores.items():
        key = session, placement
        if key not in worst or value > worst[key][2]:
            worst[key] = session, view, value
    return sorted(worst.values(), key=lambda r: (-r[2], r[:2]))


def _every_target_first(run, sensor, views):
    """Views, worst first, with the worst of every target before all others."""
    seen, first, rest = set(), [], []
    for session, view, value in views:
        target = run.sessions[session].streams[sensor].views["target"][view]
        (rest if target in seen else first).append((session, view, value))
        seen.add(target)
    return first + rest


def head(run, sensor, session, view, score):
    """What a view is, in one line, and for a failure expected against found."""
    stream = run.sessions[session].streams[sensor]
    target, placement = stream.views["target"][view], int(stream.views["placement"][view])
    line = f"{session}, view {view}: {target}, placement {placement}"
    if score is not None:
        return {"line": f"{line}; rms {score:.2f} σ", "status": None}
    return {"line": f"{line}; nothing found", "status": stream.outcomes[view]}


def _of_view(columns, session, view):
    return parquet_tables.select(
        columns, (columns["session"] == session) & (columns["view"] == view)
    )
