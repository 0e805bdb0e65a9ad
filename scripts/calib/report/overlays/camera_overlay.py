"""The image around a target with what was measured and where each pose puts it; paper Fig. 5."""

import base64
import html

import cv2
import numpy as np

from calib.estimation.residuals.residual_registry import KINDS
from calib.geometry import se3
from calib.report import number_format
from calib.report.figures.svg_plots import Drawing
from calib.report.sections import residual_tables
from calib.sensors import sensor_models
from calib.sensors.camera.images import image_messages
from calib.targets import target_shapes

MOST_PX = 640  # of an image in the report, wide
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 82]
MANY = 80  # more keypoints than this are drawn as dots
# Bright, because they lie on photographs.
SEEN, GUESS, SOLVED, ARROW = "#29e0ff", "#ff5a4a", "#3dff7f", "#ffe14a"


def draw(run, sensor, session, row, rows):
    """The Drawing of one view: keypoints and outline by first guess, result and truth."""
    model = sensor_models.camera(run.options["sensors"][sensor])
    target = target_shapes.from_config(run.options["targets"][row["target"]])
    poses = run.T_sensor_target(sensor, session, row["placement"])
    measured = _measured(run, sensor, session, row["view"], rows)
    shapes = {n: shape(model, T, target) for n, T in poses.items() if T is not None}
    image = image_messages.from_png(row["png"])
    box = region(image.shape, row, [measured, *(s for pair in shapes.values() for s in pair)])
    arrows, gain = _arrows(rows, box)
    caption = f"u {box[0]} to {box[2] - 1}, v {box[1]} to {box[3] - 1} px"
    caption += f"; residuals × {number_format.number(gain)}" if gain else ""
    marks = _marks(measured, shapes, arrows, box)
    return Drawing(picture(image, row, box, marks, caption), None, caption)


def _measured(run, sensor, session, view, rows):
    """Pixels (n, 2) measured in a view; those that never reached the solve where none did."""
    found = [c["measured"][:, :2] for k, c in rows.items() if KINDS[k].UNIT == "px"]
    if not any(map(len, found)):
        k = run.sessions[session].streams[sensor].keypoints
        here = np.asarray(k["view"]) == view
        found = [np.asarray(k["uv"], float).reshape(-1, 2)[here]]
    return np.concatenate(found)


def shape(model, T_sensor_target, target):
    """Pixels of a target's pattern (n, 2) and along its outline (m, 2), by one pose."""
    pattern = target.pattern.corners() if target.pattern else np.zeros((0, 3))
    ends = target.edges()
    if len(ends):
        fraction = np.linspace(0, 1, 12)[:, None]
        along = np.concatenate([a + fraction * (b - a) for a, b in ends])
        return _project(model, T_sensor_target, pattern), _project(model, T_sensor_target, along)
    body = _project(model, T_sensor_target, target.template(target.reach / 50))
    hull = cv2.convexHull(body.astype(np.float32))[:, 0] if len(body) > 2 else body
    return _project(model, T_sensor_target, pattern), hull.astype(float)


def _project(model, T, points):
    uv, valid = model.project(se3.transform(T, points))
    return uv[valid]


def region(shape_, row, marks):
    """Part (u0, v0, u1, v1) of the recorded region that holds the marks, with room around them."""
    low = np.array([row["u0"], row["v0"]])
    high = low + [shape_[1], shape_[0]]
    found = [m for m in marks if len(m)]
    if not found:
        return (*low.tolist(), *high.tolist())
    points = np.clip(np.concatenate(found), low, high)
    room = 0.08 * np.ptp(points, axis=0).max() + 8
    first = np.maximum(np.floor(points.min(0) - room), low).astype(int)
    last = np.minimum(np.ceil(points.max(0) + room), high).astype(int)
    return (*first.tolist(), *last.tolist())


def _arrows(rows, box):
    """Residuals of the members as (from, to) pixels, magnified to be seen, and by how much."""
    used = [residual_tables.members(c) for k, c in rows.items() if KINDS[k].UNIT == "px"]
    used = [c for c in used if residual_tables.components(c).shape[1] == 2]
    if not used:
        return np.zeros((0, 2, 2)), None
    start = np.concatenate([c["measured"][:, :2] for c in used])
    value = np.concatenate([c["value"] for c in used])
    size = residual_tables.rms(np.linalg.norm(value, axis=1))
    gain = number_format.nice((box[2] - box[0]) / 30 / max(size, 1e-9))
    return np.stack([start, start + gain * value], 1), gain


def _path(points, closed=False):
    body = "L".join(f"{u:.2f} {v:.2f}" for u, v in points)
    return f"M{body}{'Z' if closed else ''}" if len(points) else ""


def _cross(points, r, diagonal):
    a, b = ((r, r), (r, -r)) if diagonal else ((r, 0), (0, r))
    a, b = np.array(a), np.array(b)
    return "".join(_path([p - a, p + a]) + _path([p - b, p + b]) for p in points)


def stroke(d, colour, width, dash=""):
    """<path> of a line; dash: lengths, px."""
    more = f' stroke-dasharray="{dash}"' if dash else ""
    line = f'fill="none" stroke="{colour}" stroke-width="{width:.2f}"{more}'
    return f'<path {line} d="{d}"/>' if d else ""


def _marks(measured, shapes, arrows, box):
    """SVG elements over an image, in its pixels."""
    unit = (box[2] - box[0]) / 90
    thin = 0.16 * unit
    out = []
    for name, colour, diagonal in (("guess", GUESS, False), ("solved", SOLVED, True)):
        if name in shapes:
            pattern, outline = shapes[name]
            out.append(stroke(_path(outline, True), colour, 1.3 * thin))
            out.append(stroke(_cross(pattern, 0.8 * unit, diagonal), colour, 1.3 * thin))
    if "truth" in shapes:
        outline = _path(shapes["truth"][1], True)
        dash = f"{1.2 * unit:.2f} {1.2 * unit:.2f}"
        # Black on white: seen on every ground.
        out += [stroke(outline, "#fff", thin, dash), stroke(outline, "#000", 0.7 * thin, dash)]
    out.append(_dots(measured, unit))
    out.append(stroke("".join(_path(a) for a in arrows), ARROW, thin))
    return "".join(out)


def _dots(measured, unit):
    """Circles about a few keypoints, dots on many; one path, which prints much faster than many."""
    if len(measured) > MANY:
        d = "".join(f"M{u:.2f} {v:.2f}h.01" for u, v in measured)
        return stroke(d, SEEN, 0.6 * unit).replace("<path ", '<path stroke-linecap="round" ')
    r = f"{1.3 * unit:.2f}"
    half = f"a{r} {r} 0 1 0"
    ring = f"{half} {2.6 * unit:.2f} 0{half} {-2.6 * unit:.2f} 0"
    d = "".join(f"M{u - 1.3 * unit:.2f} {v:.2f}{ring}" for u, v in measured)
    return stroke(d, SEEN, 0.2 * unit)


def picture(image, row, box, marks, label):
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
