"""Each recording's placements as an MCAP for Foxglove: coloured clouds, and images with the points
of the lidars and of the targets drawn into them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calib.export.calibrated_scene import ExportScene, ExportSensor, ExportSession
from calib.export.export_mcap import encode_mcap, make_static_tf_message
from calib.export.placement_views import (
    TARGET_BGR,
    CameraView,
    LidarView,
    color_by_range,
    color_lidar_returns,
    draw_points,
    find_placement_target,
    make_camera_view,
    make_lidar_view,
    project_to_pixels,
    sample_target_points,
)
from calib.geometry.se3 import transform_points
from calib.io.logs.ros_messages import (
    CLOUD_TYPE,
    COMPRESSED_IMAGE_TYPE,
    RosMessage,
    make_compressed_image,
    make_pointcloud2,
)
from calib.io.parquet_tables import read_table
from calib.io.status import Status
from calib.report.data.run_data import COLUMNS_WITHOUT_PAYLOAD, VIEW_SCHEMAS
from calib.sensors.camera.camera_info_reader import CAMERA_INFO_TYPE
from calib.sensors.camera.camera_info_writer import make_camera_info_message
from calib.views.pose_selection import space_evenly
from calib.views.view_payloads import read_view_payloads

TITLE = (
    "the placements for Foxglove: clouds in the colours of the images, points and targets drawn "
    "into the images (3D panel: /<target>/points, /<target>/<lidar>/points; image panel: "
    "/<target>/<camera>/projected)"
)
FILE_PATTERNS: tuple[str, ...] = ("foxglove_*.mcap",)
CONVENTION = (
    "clouds lie in the frames of their sensors, targets in the parent's; each transform of "
    "/tf_static maps points of child_frame_id into header.frame_id; metres"
)
JPEG_OPTIONS = [cv2.IMWRITE_JPEG_QUALITY, 85]
COLORED_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
# RViz and Foxglove take the four bytes of a colour as a float.
COLORED_POINT_DATATYPES = {"float32": 7, "uint32": 7}


@dataclass(frozen=True)
class PlacementViews:
    """What lidars and cameras, by name, saw of a placement; target_points (n, 3), parent frame."""

    topic: str
    lidars: dict[str, LidarView]
    cameras: dict[str, CameraView]
    target_points: np.ndarray


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render foxglove_<session>.mcap of every session."""
    about = {
        "convention": CONVENTION,
        "verdict": "\n".join(scene.describe_verdict()) or scene.verdict,
        "worked_point": "\n".join(scene.describe_worked_points()),
    }
    files: dict[str, str | bytes | Status] = {}
    for name, session in scene.sessions.items():
        messages = [
            message
            for placement, rows in select_export_views(scene, session).items()
            for message in make_placement_messages(scene, session, placement, rows)
        ]
        start_ns = min([session.start_ns, *(m.log_time_ns for m in messages)])
        transforms = make_static_tf_message(start_ns, scene.static_transforms())
        files[f"foxglove_{name}.mcap"] = encode_mcap([transforms, *messages], about)
    return files


def select_export_views(
    scene: ExportScene, session: ExportSession
) -> dict[int, dict[str, dict[str, Any]]]:
    """Select placements, first those that most sensors saw, spread over the recording.

    Returns {placement: {sensor: row of views.parquet}} of at most max_views placements.
    """
    views_by_placement: dict[int, dict[str, int]] = {}
    for name, path in session.view_paths.items():
        if name in scene.sensors:
            for placement, view in _find_first_views(path, scene.sensors[name].kind).items():
                views_by_placement.setdefault(placement, {})[name] = view
    selected: list[int] = []
    for n_sensors in range(max(map(len, views_by_placement.values()), default=0), 0, -1):
        candidates = sorted(p for p, v in views_by_placement.items() if len(v) == n_sensors)
        n_free = scene.max_views - len(selected)
        selected += [candidates[i] for i in space_evenly(len(candidates), n_free)]
    rows: dict[int, dict[str, dict[str, Any]]] = {placement: {} for placement in sorted(selected)}
    for name in sorted(session.view_paths):
        placement_by_view = {
            views_by_placement[p][name]: p for p in rows if name in views_by_placement[p]
        }
        payloads = read_view_payloads(session.view_paths[name], placement_by_view)
        for view, row in payloads.items():
            rows[placement_by_view[view]][name] = row
    return rows


def _find_first_views(path: Path, kind: str) -> dict[int, int]:
    """Find the first view that was kept of each placement."""
    columns, _, _ = read_table(path, VIEW_SCHEMAS[kind], COLUMNS_WITHOUT_PAYLOAD)
    first: dict[int, int] = {}
    for i in np.flatnonzero(columns["kept"]):
        first.setdefault(int(columns["placement"][i]), int(columns["view"][i]))
    return first


def make_placement_messages(
    scene: ExportScene,
    session: ExportSession,
    placement: int,
    rows: Mapping[str, Mapping[str, Any]],
) -> list[RosMessage]:
    """Make the messages of one placement from the rows of views.parquet by sensor."""
    views = PlacementViews(
        topic=f"/{find_placement_target(session, placement)}",
        lidars={n: make_lidar_view(row) for n, row in rows.items() if n in scene.lidars},
        cameras={
            n: make_camera_view(scene.sensors[n], row)
            for n, row in rows.items()
            if n in scene.cameras
        },
        target_points=sample_target_points(scene, session, placement),
    )
    messages = []
    for name, view in views.lidars.items():
        lidar = scene.sensors[name]
        colors = color_lidar_returns(scene, lidar, view, views.cameras)
        cloud = make_colored_cloud_message(view.stamp_ns, lidar.frame, view.xyz, colors)
        messages.append(
            RosMessage(view.stamp_ns, f"{views.topic}/{name}/points", CLOUD_TYPE, cloud)
        )
    for name in views.cameras:
        messages += _make_camera_messages(scene, scene.sensors[name], views)
    stamp_ns = min(
        [v.stamp_ns for v in views.lidars.values()] + [v.stamp_ns for v in views.cameras.values()]
    )
    cloud = make_colored_cloud_message(
        stamp_ns, scene.parent_frame, views.target_points, _target_colors(views)
    )
    return [*messages, RosMessage(stamp_ns, f"{views.topic}/points", CLOUD_TYPE, cloud)]


def _target_colors(views: PlacementViews) -> np.ndarray:
    return np.tile(TARGET_BGR, (len(views.target_points), 1))


def make_colored_cloud_message(stamp_ns: int, frame: str, xyz: np.ndarray, bgr: np.ndarray) -> Any:
    """Make a PointCloud2 of points xyz (n, 3), m, in colours bgr (n, 3)."""
    points = np.zeros((1, len(xyz)), COLORED_POINT)
    for axis, key in enumerate("xyz"):
        points[key] = xyz[:, axis]
    b, g, r = np.asarray(bgr, np.uint32).reshape(-1, 3).T
    points["rgb"] = r << 16 | g << 8 | b
    return make_pointcloud2(stamp_ns, frame, points, COLORED_POINT_DATATYPES)


def _make_camera_messages(
    scene: ExportScene, sensor: ExportSensor, views: PlacementViews
) -> list[RosMessage]:
    """Make the image as it is, the image with points drawn into it, and its CameraInfo."""
    view, topic = views.cameras[sensor.name], f"{views.topic}/{sensor.name}"
    messages = [_make_jpeg_message(view.stamp_ns, f"{topic}/image", sensor.frame, view.image)]
    if sensor.camera is None:
        return messages
    drawn = view.image.copy()
    uv, _ = project_to_pixels(sensor.camera, sensor.T_parent_sensor, views.target_points)
    draw_points(drawn, uv, _target_colors(views))
    for name, scan in views.lidars.items():
        points = transform_points(scene.sensors[name].T_parent_sensor, scan.xyz)
        uv, rows = project_to_pixels(sensor.camera, sensor.T_parent_sensor, points)
        draw_points(drawn, uv, color_by_range(np.linalg.norm(scan.xyz[rows], axis=1)))
    messages.append(_make_jpeg_message(view.stamp_ns, f"{topic}/projected", sensor.frame, drawn))
    info = make_camera_info_message(view.stamp_ns, sensor.frame, sensor.camera)
    if info is not None:
        messages.append(RosMessage(view.stamp_ns, f"{topic}/camera_info", CAMERA_INFO_TYPE, info))
    return messages


def _make_jpeg_message(stamp_ns: int, topic: str, frame: str, image: np.ndarray) -> RosMessage:
    data = cv2.imencode(".jpg", image, JPEG_OPTIONS)[1].reshape(-1)
    message = make_compressed_image(stamp_ns, frame, "jpeg", data)
    return RosMessage(stamp_ns, topic, COMPRESSED_IMAGE_TYPE, message)
