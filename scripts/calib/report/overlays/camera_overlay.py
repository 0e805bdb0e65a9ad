"""A target over one image: what was measured, and where each pose puts it (paper Fig. 5)."""

from typing import Any, NamedTuple

import cv2
import numpy as np

from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.geometry.se3 import transform_points
from calib.report.data.run_data import Columns, ReportRun
from calib.report.figures.figure_encoding import Drawing
from calib.report.number_format import floor_to_nice_number, format_number
from calib.report.overlays.overlay_svg import (
    fit_image_box,
    render_svg_dots,
    render_svg_image,
    render_svg_line,
    svg_circles,
    svg_crosses,
    svg_path,
)
from calib.report.sections.residuals import residual_components, select_inlier_rows
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.camera.images.image_messages import decode_png
from calib.sensors.sensor_models import camera_from_config
from calib.targets.target_outline import sample_outline_edges
from calib.targets.target_shapes import TargetShape, target_from_config

MAX_CIRCLES = 80  # more keypoints are drawn as dots
N_POINTS_PER_EDGE = 12
# Bright, because they lie on photographs.
MEASURED_COLOR, RESIDUAL_COLOR = "#29e0ff", "#ffe14a"
GUESS_OVERLAY_COLOR, RESULT_OVERLAY_COLOR = "#ff5a4a", "#3dff7f"


class ProjectedTarget(NamedTuple):
    """Pixels of the pattern corners (n, 2) and along the outline (m, 2) of a target."""

    pattern: np.ndarray
    outline: np.ndarray


class ResidualArrows(NamedTuple):
    """Magnified residuals: start and end pixel (n, 2, 2), and the factor, None without any."""

    lines: np.ndarray
    gain: float | None


def draw_camera_overlay(
    run: ReportRun, sensor: str, session: str, view: dict[str, Any], residuals: dict[str, Columns]
) -> Drawing:
    """Draw one view: keypoints, residuals, and the target by initial guess, result and truth.

    view: row of views.parquet with its payload; residuals: of the view, by kind.
    """
    camera = camera_from_config(run.options["sensors"][sensor])
    target = target_from_config(run.options["targets"][view["target"]])
    poses = run.T_sensor_target(sensor, session, view["placement"])
    shapes = {n: project_target(camera, T, target) for n, T in poses.items() if T is not None}
    in_image = {k: c for k, c in residuals.items() if RESIDUAL_KINDS[k].UNIT == "px"}
    if any(len(c["view"]) for c in in_image.values()):
        measured = np.concatenate([c["measured"][:, :2] for c in in_image.values()])
    else:  # nothing reached the solve
        measured = _keypoint_pixels(run.sessions[session].streams[sensor].keypoints, view["view"])
    image = decode_png(view["png"])
    marks = [measured, *(pixels for shape in shapes.values() for pixels in shape)]
    box = fit_image_box(image.shape, view, marks)
    arrows = _residual_arrows(list(in_image.values()), box.width)
    caption = f"u {box.u0} to {box.u1 - 1}, v {box.v0} to {box.v1 - 1} px"
    if arrows.gain:
        caption += f"; residuals × {format_number(arrows.gain)}"
    svg = _render_marks(measured, shapes, arrows.lines, box.width)
    return Drawing(render_svg_image(image, view, box, svg, caption), None, caption)


def _keypoint_pixels(keypoints: Columns, view: int) -> np.ndarray:
    """Return the pixels (n, 2) of the keypoints of a view."""
    rows = np.asarray(keypoints["view"]) == view
    return np.asarray(keypoints["uv"], float).reshape(-1, 2)[rows]


def project_target(
    camera: CameraModel, T_camera_target: np.ndarray, target: TargetShape
) -> ProjectedTarget:
    """Project the pattern and the outline of a target; without edges, the hull of its surface."""
    corners = target.pattern.corners() if target.pattern else np.zeros((0, 3))
    pattern = _project_points(camera, T_camera_target, corners)
    edges = sample_outline_edges(target, N_POINTS_PER_EDGE)
    if len(edges):
        return ProjectedTarget(pattern, _project_points(camera, T_camera_target, edges))
    surface = target.sample_surface(target.bounding_radius / 50)
    pixels = _project_points(camera, T_camera_target, surface)
    if len(pixels) > 2:
        pixels = cv2.convexHull(pixels.astype(np.float32))[:, 0].astype(float)
    return ProjectedTarget(pattern, pixels)


def _project_points(camera: CameraModel, T: np.ndarray, points: np.ndarray) -> np.ndarray:
    pixels, is_valid = camera.project(transform_points(T, points))
    return pixels[is_valid]


def _residual_arrows(residuals: list[Columns], image_width: int) -> ResidualArrows:
    """Return the residuals (u, v) of the inliers, magnified to 1/30 of the image width."""
    inliers = [select_inlier_rows(c) for c in residuals]
    inliers = [c for c in inliers if residual_components(c).shape[1] == 2]
    if not inliers:
        return ResidualArrows(np.zeros((0, 2, 2)), None)
    start = np.concatenate([c["measured"][:, :2] for c in inliers])
    value = np.concatenate([c["value"] for c in inliers])
    rms = float(np.sqrt(np.mean(np.sum(value**2, axis=1))))
    gain = floor_to_nice_number(image_width / 30 / max(rms, 1e-9))
    return ResidualArrows(np.stack([start, start + gain * value], 1), gain)


def _render_marks(
    measured: np.ndarray, shapes: dict[str, ProjectedTarget], arrows: np.ndarray, image_width: int
) -> str:
    """Render the marks over an image, in its pixels."""
    unit = image_width / 90
    thin = 0.16 * unit
    parts = []
    for name, color, is_diagonal in (
        ("guess", GUESS_OVERLAY_COLOR, False),
        ("result", RESULT_OVERLAY_COLOR, True),
    ):
        if name in shapes:
            outline = svg_path(shapes[name].outline, is_closed=True)
            crosses = svg_crosses(shapes[name].pattern, 0.8 * unit, is_diagonal)
            parts += [render_svg_line(path, color, 1.3 * thin) for path in (outline, crosses)]
    if "truth" in shapes:
        outline = svg_path(shapes["truth"].outline, is_closed=True)
        dash = f"{1.2 * unit:.2f} {1.2 * unit:.2f}"
        # Black on white is visible on any background.
        parts.append(render_svg_line(outline, "#fff", thin, dash))
        parts.append(render_svg_line(outline, "#000", 0.7 * thin, dash))
    if len(measured) > MAX_CIRCLES:
        parts.append(render_svg_dots(measured, MEASURED_COLOR, 0.6 * unit))
    else:
        circles = svg_circles(measured, 1.3 * unit)
        parts.append(render_svg_line(circles, MEASURED_COLOR, 0.2 * unit))
    parts.append(render_svg_line("".join(map(svg_path, arrows)), RESIDUAL_COLOR, thin))
    return "".join(parts)
