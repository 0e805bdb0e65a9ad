"""Returns of a lidar on the image of a camera that saw the same placement: guess and result."""

import numpy as np

from calib.geometry.se3 import invert_pose, transform_points
from calib.report.figures.captions import LIDAR_ON_IMAGE
from calib.report.figures.svg_plots import Drawing
from calib.report.overlays.camera_overlay import fit_image_box, render_svg_image, render_svg_stroke
from calib.report.sections.extrinsics import initial_guess_pose
from calib.report.sections.residual_tables import residuals_by_kind, score_views
from calib.sensors.camera.images.image_messages import decode_png
from calib.sensors.sensor_models import camera_from_config
from calib.views.view_payloads import read_view_payloads

DISTANCE_COLORS = ("#fde725", "#90d743", "#35b779", "#21918c", "#31688e", "#7b6cc4")
POSE_TITLES = {"guess": "by the first guesses", "result": "by the result"}


def draw_lidar_on_images(run):
    """[{name, views: [(title, Drawing)]}] of every camera and lidar with a common placement."""
    out = []
    if not run.options["report"]["max_overlays"]:
        return out
    solved = [n for n in run.sensors if run.T_robot_sensor(n) is not None]
    for camera in (n for n in solved if run.sensors[n]["kind"] == "camera"):
        for lidar in (n for n in solved if run.sensors[n]["kind"] == "lidar"):
            common = select_common_views(run, camera, lidar)
            if common:
                session, views = common
                drawn = _draw_guess_and_result(run, session, (camera, lidar), views)
                out.append({"name": f"{lidar} on {camera}", "views": drawn})
    return out


def select_common_views(run, camera, lidar):
    """(session, (view of the camera, view of the lidar)) of the placement that both saw and in
    which the lidar has the most members; None without one."""
    seen = [_best_views(run, n) for n in (camera, lidar)]
    common = sorted(set(seen[0]) & set(seen[1]))
    if not common:
        return None
    at = max(common, key=lambda key: seen[1][key][1])
    return at[0], (seen[0][at][0], seen[1][at][0])


def _best_views(run, sensor):
    """{(session, placement): (view, members)} of the view with the most members."""
    out = {}
    for (session, view), (placement, _, n) in score_views(residuals_by_kind(run, sensor)).items():
        if n > out.get((session, placement), (0, 0))[1]:
            out[session, placement] = view, n
    return out


def _draw_guess_and_result(run, session, sensors, view_numbers):
    """[(title, Drawing)] by the first guesses and by the result."""
    streams = [run.sessions[session].streams[n] for n in sensors]
    rows = [
        read_view_payloads(s.views_path, [v])[v] for s, v in zip(streams, view_numbers, strict=True)
    ]
    points = np.asarray(rows[1]["xyz"], float).reshape(-1, 3)
    model, image = (
        camera_from_config(run.options["sensors"][sensors[0]]),
        decode_png(rows[0]["png"]),
    )
    out = []
    for by, title in POSE_TITLES.items():
        T = [_select_sensor_pose(run, n, by) for n in sensors]
        if all(t is not None for t in T):
            T_camera_lidar = invert_pose(T[0]) @ T[1]
            where = f"{session}, view {view_numbers[0]} of {sensors[0]}, view {view_numbers[1]} of {sensors[1]}"
            drawn = _draw_points_on_image(
                model, image, rows[0], transform_points(T_camera_lidar, points), where
            )
            out.append((title, drawn))
    return out


def _select_sensor_pose(run, sensor, by):
    guess = initial_guess_pose(run.sensors[sensor])
    return guess if by == "guess" else run.T_robot_sensor(sensor)


def _draw_points_on_image(model, image, row, points, view_label):
    """The image with points (n, 3), camera frame, m, in the colours of their distance."""
    uv, ok = model.project(points)
    u0, v0, u1, v1 = box = fit_image_box(image.shape, row, [])
    ok &= (uv[:, 0] >= u0) & (uv[:, 0] < u1) & (uv[:, 1] >= v0) & (uv[:, 1] < v1)
    uv, far = uv[ok], np.linalg.norm(points[ok], axis=1)
    edges = np.quantile(far, np.linspace(0, 1, len(DISTANCE_COLORS) + 1)[1:-1]) if len(far) else []
    band, marks = np.searchsorted(edges, far), ""
    for k, colour in enumerate(DISTANCE_COLORS):
        d = "".join(f"M{u:.1f} {v:.1f}h.01" for u, v in uv[band == k])
        dots = render_svg_stroke(d, colour, (u1 - u0) / 160)
        marks += dots.replace("<path ", '<path stroke-linecap="round" ')
    caption = f"{view_label}; {len(uv)} returns in the image"
    return Drawing(render_svg_image(image, row, box, marks, caption), None, caption, LIDAR_ON_IMAGE)
