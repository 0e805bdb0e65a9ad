"""Returns of a lidar on the image of a camera that saw the same placement: guess and result."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calib.geometry.se3 import invert_pose, transform_points
from calib.report.data.run_data import ReportRun
from calib.report.figures.captions import LIDAR_ON_IMAGE
from calib.report.figures.figure_encoding import Drawing
from calib.report.overlays.overlay_svg import fit_image_box, render_svg_dots, render_svg_image
from calib.report.sections.extrinsics import initial_guess_pose
from calib.report.sections.residuals import residuals_by_kind, score_views
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.camera.images.image_messages import decode_png
from calib.sensors.sensor_models import camera_from_config
from calib.views.view_payloads import read_view_payloads

DISTANCE_COLORS = ("#fde725", "#90d743", "#35b779", "#21918c", "#31688e", "#7b6cc4")


class CommonViews(NamedTuple):
    """Views of a camera and of a lidar in one session that show the same placement."""

    session: str
    camera_view: int
    lidar_view: int


class BestView(NamedTuple):
    """The view of a placement with the most residuals of inliers."""

    view: int
    n_residuals: int


def draw_lidar_on_images(run: ReportRun) -> list[dict[str, Any]]:
    """Return {name, views: [(title, Drawing)]} of each camera and lidar with a common placement."""
    if not run.options["report"]["max_overlays"]:
        return []
    kinds = {n: s["kind"] for n, s in run.sensors.items() if run.T_robot_sensor(n) is not None}
    overlays = []
    for camera in (n for n, kind in kinds.items() if kind == "camera"):
        for lidar in (n for n, kind in kinds.items() if kind == "lidar"):
            common = select_common_views(run, camera, lidar)
            if common:
                drawings = _draw_guess_and_result(run, camera, lidar, common)
                overlays.append({"name": f"{lidar} on {camera}", "views": drawings})
    return overlays


def select_common_views(run: ReportRun, camera: str, lidar: str) -> CommonViews | None:
    """Return the views of the common placement with the most inliers of the lidar, or None."""
    camera_views, lidar_views = _best_views(run, camera), _best_views(run, lidar)
    common = sorted(set(camera_views) & set(lidar_views))
    if not common:
        return None
    key = max(common, key=lambda k: lidar_views[k].n_residuals)
    return CommonViews(key[0], camera_views[key].view, lidar_views[key].view)


def _best_views(run: ReportRun, sensor: str) -> dict[tuple[str, int], BestView]:
    """Return the view with the most residuals of inliers by session and placement."""
    best: dict[tuple[str, int], BestView] = {}
    for (session, view), (placement, _, n) in score_views(residuals_by_kind(run, sensor)).items():
        key = session, placement
        if key not in best or n > best[key].n_residuals:
            best[key] = BestView(view, n)
    return best


def _draw_guess_and_result(
    run: ReportRun, camera: str, lidar: str, common: CommonViews
) -> list[tuple[str, Drawing]]:
    """Return (title, Drawing) by the initial guesses and by the result."""
    streams = run.sessions[common.session].streams
    image_row = _read_view(streams[camera].views_path, common.camera_view)
    cloud_row = _read_view(streams[lidar].views_path, common.lidar_view)
    points = np.asarray(cloud_row["xyz"], float).reshape(-1, 3)
    model = camera_from_config(run.options["sensors"][camera])
    label = (
        f"{common.session}, view {common.camera_view} of {camera}, "
        f"view {common.lidar_view} of {lidar}"
    )
    guesses = [initial_guess_pose(run.sensors[n]) for n in (camera, lidar)]
    results = [run.T_robot_sensor(n) for n in (camera, lidar)]
    drawings = []
    for title, (T_robot_camera, T_robot_lidar) in (
        ("by the initial guesses", guesses),
        ("by the result", results),
    ):
        if T_robot_camera is not None and T_robot_lidar is not None:
            T_camera_lidar = invert_pose(T_robot_camera) @ T_robot_lidar
            in_camera = transform_points(T_camera_lidar, points)
            drawings.append((title, _draw_points_on_image(model, image_row, in_camera, label)))
    return drawings


def _read_view(path: Path, view: int) -> dict[str, Any]:
    return read_view_payloads(path, [view])[view]


def _draw_points_on_image(
    camera: CameraModel, view: dict[str, Any], points: np.ndarray, label: str
) -> Drawing:
    """Draw points (n, 3), camera frame, m, on the image of a view, coloured by distance."""
    image = decode_png(view["png"])
    pixels, is_valid = camera.project(points)
    box = fit_image_box(image.shape, view, [])
    is_inside = (pixels >= (box.u0, box.v0)) & (pixels < (box.u1, box.v1))
    rows = is_valid & is_inside.all(axis=1)
    pixels, distance = pixels[rows], np.linalg.norm(points[rows], axis=1)
    n_bands = len(DISTANCE_COLORS)
    quantiles = np.linspace(0, 1, n_bands + 1)[1:-1]
    edges = np.quantile(distance, quantiles) if len(distance) else []
    band = np.searchsorted(edges, distance)
    marks = "".join(
        render_svg_dots(pixels[band == k], color, box.width / 160, decimals=1)
        for k, color in enumerate(DISTANCE_COLORS)
    )
    caption = f"{label}; {len(pixels)} returns in the image"
    svg = render_svg_image(image, view, box, marks, caption)
    return Drawing(svg, None, caption, LIDAR_ON_IMAGE)
