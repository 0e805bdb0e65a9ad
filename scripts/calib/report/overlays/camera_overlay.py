"""The image around a target with what was measured and where each pose puts it; paper Fig. 5."""

import base64
import html

import cv2
import numpy as np

from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.geometry.se3 import transform_points
from calib.report.figures.svg_plots import Drawing
from calib.report.number_format import floor_to_nice_number, format_number
from calib.report.sections.residual_tables import (
    residual_components,
    root_mean_square,
    select_inlier_rows,
)
from calib.sensors.camera.images.image_messages import decode_png
from calib.sensors.sensor_models import camera_from_config
from calib.targets.target_shapes import target_from_config

MAX_IMAGE_WIDTH_PX = 640  # of an image in the report, wide
JPEG_OPTIONS = [cv2.IMWRITE_JPEG_QUALITY, 82]
MAX_CIRCLES = 80  # more keypoints than this are drawn as dots
# Bright, because they lie on photographs.
MEASURED_COLOR, GUESS_OVERLAY_COLOR, RESULT_OVERLAY_COLOR, RESIDUAL_COLOR = (
    "#29e0ff",
    "#ff5a4a",
    "#3dff7f",
    "#ffe14a",
)


def draw_camera_overlay(run, sensor, session, row, rows):
    """The Drawing of one view: keypoints and outline by first guess, result and truth."""
    model = camera_from_config(run.options["sensors"][sensor])
    target = target_from_config(run.options["targets"][row["target"]])
    poses = run.T_sensor_target(sensor, session, row["placement"])
    measured = _measured_pixels(run, sensor, session, row["view"], rows)
    shapes = {n: project_target_shape(model, T, target) for n, T in poses.items() if T is not None}
    image = decode_png(row["png"])
    box = fit_image_box(
        image.shape, row, [measured, *(s for pair in shapes.values() for s in pair)]
    )
    arrows, gain = _residual_arrows(rows, box)
    caption = f"u {box[0]} to {box[2] - 1}, v {box[1]} to {box[3] - 1} px"
    caption += f"; residuals × {format_number(gain)}" if gain else ""
    marks = _render_marks(measured, shapes, arrows, box)
    return Drawing(render_svg_image(image, row, box, marks, caption), None, caption)


def _measured_pixels(run, sensor, session, view, rows):
    """Pixels (n, 2) measured in a view; those that never reached the solve where none did."""
    found = [c["measured"][:, :2] for k, c in rows.items() if RESIDUAL_KINDS[k].UNIT == "px"]
    if not any(map(len, found)):
        k = run.sessions[session].streams[sensor].keypoints
        here = np.asarray(k["view"]) == view
        found = [np.asarray(k["uv"], float).reshape(-1, 2)[here]]
    return np.concatenate(found)


def project_target_shape(model, T_sensor_target, target):
    """Pixels of a target's pattern (n, 2) and along its outline (m, 2), by one pose."""
    pattern = target.pattern.corners() if target.pattern else np.zeros((0, 3))
    ends = target.outline_edges()
    if len(ends):
        fraction = np.linspace(0, 1, 12)[:, None]
        along = np.concatenate([a + fraction * (b - a) for a, b in ends])
        return _project_points(model, T_sensor_target, pattern), _project_points(
            model, T_sensor_target, along
        )
    body = _project_points(
        model, T_sensor_target, target.sample_surface(target.bounding_radius / 50)
    )
    hull = cv2.convexHull(body.astype(np.float32))[:, 0] if len(body) > 2 else body
    return _project_points(model, T_sensor_target, pattern), hull.astype(float)


def _project_points(model, T, points):
    uv, valid = model.project(transform_points(T, points))
    return uv[valid]


def fit_image_box(image_shape, row, marks):
    """Part (u0, v0, u1, v1) of the recorded region that holds the marks, with room around them."""
    low = np.array([row["u0"], row["v0"]])
    high = low + [image_shape[1], image_shape[0]]
    found = [m for m in marks if len(m)]
    if not found:
        return (*low.tolist(), *high.tolist())
    points = np.clip(np.concatenate(found), low, high)
    room = 0.08 * np.ptp(points, axis=0).max() + 8
    first = np.maximum(np.floor(points.min(0) - room), low).astype(int)
    last = np.minimum(np.ceil(points.max(0) + room), high).astype(int)
    return (*first.tolist(), *last.tolist())


def _residual_arrows(rows, box):
    """Residuals of the members as (from, to) pixels, magnified to be seen, and by how much."""
    used = [select_inlier_rows(c) for k, c in rows.items() if RESIDUAL_KINDS[k].UNIT == "px"]
    used = [c for c in used if residual_components(c).shape[1] == 2]
    if not used:
        return np.zeros((0, 2, 2)), None
    start = np.concatenate([c["measured"][:, :2] for c in used])
    value = np.concatenate([c["value"] for c in used])
    size = root_mean_square(np.linalg.norm(value, axis=1))
    gain = floor_to_nice_number((box[2] - box[0]) / 30 / max(size, 1e-9))
    return np.stack([start, start + gain * value], 1), gain


def _svg_path(points, closed=False):
    body = "L".join(f"{u:.2f} {v:.2f}" for u, v in points)
    return f"M{body}{'Z' if closed else ''}" if len(points) else ""


def _svg_crosses(points, r, diagonal):
    a, b = ((r, r), (r, -r)) if diagonal else ((r, 0), (0, r))
    a, b = np.array(a), np.array(b)
    return "".join(_svg_path([p - a, p + a]) + _svg_path([p - b, p + b]) for p in points)


def render_svg_stroke(d, colour, width, dash=""):
    """<path> of a line; dash: lengths, px."""
    more = f' stroke-dasharray="{dash}"' if dash else ""
    line = f'fill="none" stroke="{colour}" stroke-width="{width:.2f}"{more}'
    return f'<path {line} d="{d}"/>' if d else ""


def _render_marks(measured, shapes, arrows, image_box):
    """SVG elements over an image, in its pixels."""
    unit = (image_box[2] - image_box[0]) / 90
    thin = 0.16 * unit
    out = []
    for name, colour, diagonal in (
        ("guess", GUESS_OVERLAY_COLOR, False),
        ("solved", RESULT_OVERLAY_COLOR, True),
    ):
        if name in shapes:
            pattern, outline = shapes[name]
            out.append(render_svg_stroke(_svg_path(outline, True), colour, 1.3 * thin))
            out.append(
                render_svg_stroke(_svg_crosses(pattern, 0.8 * unit, diagonal), colour, 1.3 * thin)
            )
    if "truth" in shapes:
        outline = _svg_path(shapes["truth"][1], True)
        dash = f"{1.2 * unit:.2f} {1.2 * unit:.2f}"
        # Black on white: seen on every ground.
        out += [
            render_svg_stroke(outline, "#fff", thin, dash),
            render_svg_stroke(outline, "#000", 0.7 * thin, dash),
        ]
    out.append(_render_dots(measured, unit))
    out.append(render_svg_stroke("".join(_svg_path(a) for a in arrows), RESIDUAL_COLOR, thin))
    return "".join(out)


def _render_dots(measured, unit):
    """Circles about a few keypoints, dots on many; one path, which prints much faster than many."""
    if len(measured) > MAX_CIRCLES:
        d = "".join(f"M{u:.2f} {v:.2f}h.01" for u, v in measured)
        return render_svg_stroke(d, MEASURED_COLOR, 0.6 * unit).replace(
            "<path ", '<path stroke-linecap="round" '
        )
    r = f"{1.3 * unit:.2f}"
    half = f"a{r} {r} 0 1 0"
    ring = f"{half} {2.6 * unit:.2f} 0{half} {-2.6 * unit:.2f} 0"
    d = "".join(f"M{u - 1.3 * unit:.2f} {v:.2f}{ring}" for u, v in measured)
    return render_svg_stroke(d, MEASURED_COLOR, 0.2 * unit)


def render_svg_image(image, row, box, marks, label):
    """<svg> of part of a region with marks, in the pixels of the whole image."""
    u0, v0, u1, v1 = box
    part = image[v0 - row["v0"] : v1 - row["v0"], u0 - row["u0"] : u1 - row["u0"]]
    width, height = u1 - u0, v1 - v0
    if width > MAX_IMAGE_WIDTH_PX:
        size = MAX_IMAGE_WIDTH_PX, max(1, round(height * MAX_IMAGE_WIDTH_PX / width))
        part = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    data = base64.b64encode(cv2.imencode(".jpg", part, JPEG_OPTIONS)[1].tobytes()).decode()
    where = f'x="{u0 - 0.5}" y="{v0 - 0.5}" width="{width}" height="{height}"'
    view = f'viewBox="{u0 - 0.5} {v0 - 0.5} {width} {height}"'
    return (
        f'<svg class="photo" role="img" aria-label="{html.escape(label)}" {view}>'
        f'<image {where} preserveAspectRatio="none" href="data:image/jpeg;base64,{data}"/>'
        f"{marks}</svg>"
    )
