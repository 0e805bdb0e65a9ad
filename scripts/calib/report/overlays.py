"""Targets as a sensor saw them against where guess and solution put them: the worst first."""

import base64
import html

import cv2
import numpy as np

from calib import geometry, images, rig, tables, targets
from calib.report import lidar_overlays, residuals, text
from calib.report.run import payloads

MOST_PX = 640  # of an image in the report, wide
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 82]


def of_sensor(run, sensor):
    """Overlays of one sensor: the worst view of the worst placements, then views without a find."""
    chosen = choose(run, sensor, run.options["report"]["max_overlays"])
    read = {
        session: payloads(stream.path, [v for s, v, _ in chosen if s == session])
        for session, stream in streams(run, sensor).items()
    }
    draw = camera if run.sensors[sensor]["kind"] == "camera" else lidar_overlays.draw
    rows = residuals.of(run, sensor)
    out = []
    for session, view, score in chosen:
        here = {k: _of_view(c, session, view) for k, c in rows.items()}
        out.append(
            draw(run, sensor, session, read[session][view], here)
            | {"head": head(run, sensor, session, view, score)}
        )
    return out


def streams(run, sensor):
    """{session: Stream} of the sessions that use a sensor."""
    return {n: s.streams[sensor] for n, s in run.sessions.items() if sensor in s.streams}


def choose(run, sensor, most):
    """[(session, view, score or None)]: one per placement, the worst first, then some failures."""
    scores = residuals.view_scores(residuals.of(run, sensor))
    best = {}
    for (session, view), (placement, value, _) in scores.items():
        key = session, placement
        if key not in best or value > best[key][2]:
            best[key] = session, view, value
    used = sorted(best.values(), key=lambda r: (-r[2], r[:2]))
    used = _every_target_first(run, sensor, used)
    failed = [
        (session, view, None)
        for session, stream in streams(run, sensor).items()
        for view, status in sorted(stream.outcomes.items())
        if not status.ok
    ]
    n_failed = min(len(failed), max(most // 3, most - len(used)))
    shown = sorted(used[: most - n_failed], key=lambda r: (-r[2], r[:2]))
    return shown + failed[:n_failed]


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
    return tables.select(columns, (columns["session"] == session) & (columns["view"] == view))


def camera(run, sensor, session, row, rows):
    """The image around the target with its corners as detected, guessed and solved."""
    model = rig.camera(run.options["sensors"][sensor])
    target = targets.from_config(run.options["targets"][row["target"]])
    guess, solved = run.T_sensor_target(sensor, session, row["placement"])
    corners = rows.get("corner")
    detected = np.zeros((0, 2)) if corners is None else corners["measured"][:, :2]
    if not len(detected):
        detected = _keypoints(run, sensor, session, row["view"])
    pattern = target.pattern.corners() if target.pattern else np.zeros((0, 3))
    shapes = {n: (None if T is None else _project(model, T, pattern), _outline(model, T, target))
              for n, T in (("guess", guess), ("solved", solved))}  # fmt: skip
    image = images.from_png(row["png"])
    box = _box(image.shape, row, [detected, *(s for pair in shapes.values() for s in pair)])
    arrows, gain = _arrows(corners, box)
    marks = _marks(detected, shapes, arrows, box)
    caption = f"u {box[0]} to {box[2] - 1}, v {box[1]} to {box[3] - 1} px"
    caption += f"; residuals × {text.number(gain)}" if gain else ""
    return {"svgs": [_picture(image, row, box, marks, caption)], "caption": caption}


def _keypoints(run, sensor, session, view):
    k = run.sessions[session].streams[sensor].keypoints
    rows = (np.asarray(k["view"]) == view) & (np.asarray(k["kind"], str) == "corner")
    return np.asarray(k["uv"], float).reshape(-1, 2)[rows]


def _project(model, T, points):
    uv, valid = model.project(geometry.transform(T, points))
    return uv[valid]


def _outline(model, T, target):
    """Pixels (n, 2) along the edges of a flat target; None without a pose or without edges."""
    ends = target.edges()
    if T is None or not len(ends):
        return None
    fraction = np.linspace(0, 1, 12)[:, None]
    along = np.concatenate([a + fraction * (b - a) for a, b in ends])
    return _project(model, T, along)


def _box(shape, row, marks):
    """Part (u0, v0, u1, v1) of the recorded region that holds the marks, with room around them."""
    low, high = (
        np.array([row["u0"], row["v0"]]),
        np.array([row["u0"] + shape[1], row["v0"] + shape[0]]),
    )
    found = [m for m in marks if m is not None and len(m)]
    if not found:
        return (*low.tolist(), *high.tolist())
    points = np.clip(np.concatenate(found), low, high)
    room = 0.08 * np.ptp(points, axis=0).max() + 8
    first = np.maximum(np.floor(points.min(0) - room), low).astype(int)
    last = np.minimum(np.ceil(points.max(0) + room), high).astype(int)
    return (*first.tolist(), *last.tolist())


def _arrows(corners, box):
    """Residuals of the members as (from, to) pixels, magnified to be seen, and by how much."""
    used = None if corners is None else residuals.members(corners)
    if used is None or not len(used["weight"]):
        return np.zeros((0, 2, 2)), None
    size = residuals.rms(np.linalg.norm(used["value"], axis=1))
    gain = text.nice((box[2] - box[0]) / 30 / max(size, 1e-9))
    start = used["measured"][:, :2]
    return np.stack([start, start + gain * used["value"]], 1), gain


def _path(points, closed=False):
    body = "L".join(f"{u:.2f} {v:.2f}" for u, v in points)
    return f"M{body}{'Z' if closed else ''}" if len(points) else ""


def _cross(points, r, diagonal):
    a, b = ((r, r), (r, -r)) if diagonal else ((r, 0), (0, r))
    return "".join(_path([p - a, p + a]) + _path([p - b, p + b]) for p in points)


def _marks(detected, shapes, arrows, box):
    """SVG elements over an image, in its pixels."""
    r = (box[2] - box[0]) / 90
    out = []
    for name, (uv, outline) in shapes.items():
        if outline is not None:
            out.append(f'<path class="m {name} line" d="{_path(outline, True)}"/>')
        if uv is not None:
            out.append(f'<path class="m {name}" d="{_cross(uv, 0.8 * r, name == "solved")}"/>')
    out += [
        f'<circle class="m seen" cx="{u:.2f}" cy="{v:.2f}" r="{1.3 * r:.2f}"/>' for u, v in detected
    ]
    out.append(f'<path class="m arrow" d="{"".join(_path(a) for a in arrows)}"/>')
    return "".join(out)


def _picture(image, row, box, marks, label):
    """<svg> of part of a region with marks, in the pixels of the whole image."""
    u0, v0, u1, v1 = box
    part = image[v0 - row["v0"] : v1 - row["v0"], u0 - row["u0"] : u1 - row["u0"]]
    width, height = u1 - u0, v1 - v0
    if width > MOST_PX:
        size = MOST_PX, max(1, round(height * MOST_PX / width))
        part = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    data = base64.b64encode(cv2.imencode(".jpg", part, JPEG)[1].tobytes()).decode()
    where = f'x="{u0 - 0.5}" y="{v0 - 0.5}" width="{width}" height="{height}"'
    view = f'viewBox="{u0 - 0.5} {v0 - 0.5} {width} {height}"'
    return (
        f'<svg class="photo" role="img" aria-label="{html.escape(label)}" {view}>'
        f'<image {where} preserveAspectRatio="none" href="data:image/jpeg;base64,{data}"/>'
        f"{marks}</svg>"
    )
