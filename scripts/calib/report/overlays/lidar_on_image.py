"""Returns of a lidar on the image of a camera that saw the same placement: guess and result."""

import numpy as np

from calib.geometry import se3
from calib.report.figures import captions
from calib.report.figures.svg_plots import Drawing
from calib.report.overlays.camera_overlay import picture, region, stroke
from calib.report.sections import extrinsics, residual_tables
from calib.sensors import sensor_models
from calib.sensors.camera.images import image_messages
from calib.views.view_payloads import payloads

NEAR_TO_FAR = ("#fde725", "#90d743", "#35b779", "#21918c", "#31688e", "#7b6cc4")
POSES = {"guess": "by the first guesses", "result": "by the result"}


def draw(run):
    """[{name, views: [(title, Drawing)]}] of every camera and lidar with a common placement."""
    out = []
    if not run.options["report"]["max_overlays"]:
        return out
    solved = [n for n in run.sensors if run.T_robot_sensor(n) is not None]
    for camera in (n for n in solved if run.sensors[n]["kind"] == "camera"):
        for lidar in (n for n in solved if run.sensors[n]["kind"] == "lidar"):
            common = choose(run, camera, lidar)
            if common:
                session, views = common
                drawn = _both(run, session, (camera, lidar), views)
                out.append({"name": f"{lidar} on {camera}", "views": drawn})
    return out


def choose(run, camera, lidar):
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
    for (session, view), (placement, _, n) in residual_tables.view_scores(
        residual_tables.of(run, sensor)
    ).items():
        if n > out.get((session, placement), (0, 0))[1]:
            out[session, placement] = view, n
    return out


def _both(run, session, sensors, views):
    """[(title, Drawing)] by the first guesses and by the result."""
    streams = [run.sessions[session].streams[n] for n in sensors]
    rows = [payloads(s.path, [v])[v] for s, v in zip(streams, views, strict=True)]
    points = np.asarray(rows[1]["xyz"], float).reshape(-1, 3)
    model, image = (
        sensor_models.camera(run.options["sensors"][sensors[0]]),
        image_messages.from_png(rows[0]["png"]),
    )
    out = []
    for by, title in POSES.items():
        T = [_pose(run, n, by) for n in sensors]
        if all(t is not None for t in T):
            T_camera_lidar = se3.inverse(T[0]) @ T[1]
            where = f"{session}, view {views[0]} of {sensors[0]}, view {views[1]} of {sensors[1]}"
            drawn = _draw(model, image, rows[0], se3.transform(T_camera_lidar, points), where)
            out.append((title, drawn))
    return out


def _pose(run, sensor, by):
    guess = extrinsics.guess(run.sensors[sensor])
    return guess if by == "guess" else run.T_robot_sensor(sensor)


def _draw(model, image, row, points, where):
    """The image with points (n, 3), camera frame, m, in the colours of their distance."""
    uv, ok = model.project(points)
    u0, v0, u1, v1 = box = region(image.shape, row, [])
    ok &= (uv[:, 0] >= u0) & (uv[:, 0] < u1) & (uv[:, 1] >= v0) & (uv[:, 1] < v1)
    uv, far = uv[ok], np.linalg.norm(points[ok], axis=1)
    edges = np.quantile(far, np.linspace(0, 1, len(NEAR_TO_FAR) + 1)[1:-1]) if len(far) else []
    band, marks = np.searchsorted(edges, far), ""
    for k, colour in enumerate(NEAR_TO_FAR):
        d = "".join(f"M{u:.1f} {v:.1f}h.01" for u, v in uv[band == k])
        dots = stroke(d, colour, (u1 - u0) / 160)
        marks += dots.replace("<path ", '<path stroke-linecap="round" ')
    caption = f"{where}; {len(uv)} returns in the image"
    return Drawing(picture(image, row, box, marks, caption), None, caption, captions.SHARED)
