"""What sensors saw at a placement: returns in the colours of images, points drawn into images."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from calib.export.calibrated_scene import ExportScene, ExportSensor, ExportSession
from calib.geometry.se3 import invert_pose, pose_from_xyz_quat, transform_points
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.camera.images.image_messages import decode_png
from calib.targets.target_outline import sample_outline_edges
from calib.targets.target_shapes import target_from_config

UNCOLORED_BGR = (150, 150, 150)  # of returns that no image shows
TARGET_BGR = (90, 230, 60)
NEAREST_BGR, FARTHEST_BGR = (60, 60, 255), (255, 130, 40)  # of returns drawn into an image
N_OUTLINE_POINTS = 60  # points along an edge of a target, or along its extent


@dataclass(frozen=True)
class LidarView:
    """The returns xyz (n, 3), m, of one scan around a target, in the lidar's frame."""

    stamp_ns: int
    xyz: np.ndarray


@dataclass(frozen=True)
class CameraView:
    """One whole image (h, w, 3), BGR, black outside the kept part; pixel_mask (h, w): that part."""

    stamp_ns: int
    image: np.ndarray
    pixel_mask: np.ndarray


def make_lidar_view(row: Mapping[str, Any]) -> LidarView:
    """Make the view of a row of a lidar's views.parquet; drops missing returns."""
    xyz = np.asarray(row["xyz"], float).reshape(-1, 3)
    return LidarView(row["stamp_ns"], xyz[np.isfinite(xyz).all(1) & (xyz != 0).any(1)])


def make_camera_view(sensor: ExportSensor, row: Mapping[str, Any]) -> CameraView:
    """Make the view of a row of a camera's views.parquet, which holds a part of the image."""
    part = decode_png(row["png"])
    v1, u1 = row["v0"] + part.shape[0], row["u0"] + part.shape[1]
    width, height = sensor.camera.size_px if sensor.camera else (u1, v1)
    image, pixel_mask = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), bool)
    kept = np.s_[row["v0"] : v1, row["u0"] : u1]
    image[kept], pixel_mask[kept] = part, True
    return CameraView(row["stamp_ns"], image, pixel_mask)


def find_placement_target(session: ExportSession, placement: int) -> str:
    """Return the name of the target of a placement."""
    return str(session.placements["target"][_placement_row(session, placement)])


def _placement_row(session: ExportSession, placement: int) -> int:
    return int(np.flatnonzero(np.asarray(session.placements["placement"]) == placement)[0])


def sample_target_points(scene: ExportScene, session: ExportSession, placement: int) -> np.ndarray:
    """Sample points (n, 3), m, of a placement's target where the MCS has it, in the parent frame.

    Returns none if the mount of the target is unknown.
    """
    name = find_placement_target(session, placement)
    if name not in scene.T_body_target:
        return np.zeros((0, 3))
    row = _placement_row(session, placement)
    T_markers_body = pose_from_xyz_quat(
        session.placements["xyz"][row], session.placements["quat"][row]
    )
    T_parent_markers = scene.T_parent_robot @ session.T_robot_body
    T_parent_target = T_parent_markers @ T_markers_body @ scene.T_body_target[name]
    target = target_from_config(scene.targets[name])
    points = sample_outline_edges(target, N_OUTLINE_POINTS)
    if not len(points):
        points = target.sample_surface(2 * target.bounding_radius / N_OUTLINE_POINTS)
    corners = target.pattern.corners() if target.pattern else np.zeros((0, 3))
    return transform_points(T_parent_target, np.concatenate([points, corners]))


def project_to_pixels(
    camera: CameraModel, T_parent_sensor: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Project points (n, 3), parent frame, into an image.

    Returns whole pixels (m, 2) of those in the image, and their rows (m,).
    """
    uv, is_valid = camera.project(transform_points(invert_pose(T_parent_sensor), points))
    rows = np.flatnonzero(is_valid & camera.is_in_image(uv))
    last = np.subtract(camera.size_px, 1)
    return np.clip(np.rint(uv[rows]).astype(int), 0, last), rows


def color_lidar_returns(
    scene: ExportScene,
    lidar: ExportSensor,
    view: LidarView,
    camera_views: Mapping[str, CameraView],
) -> np.ndarray:
    """Return BGR (n, 3) of a scan's returns: of the images that show them, else grey."""
    colors = np.tile(np.array(UNCOLORED_BGR, np.uint8), (len(view.xyz), 1))
    points = transform_points(lidar.T_parent_sensor, view.xyz)
    for name, camera_view in camera_views.items():
        sensor = scene.sensors[name]
        if sensor.camera is None:
            continue
        uv, rows = project_to_pixels(sensor.camera, sensor.T_parent_sensor, points)
        is_shown = camera_view.pixel_mask[uv[:, 1], uv[:, 0]]
        colors[rows[is_shown]] = camera_view.image[uv[is_shown, 1], uv[is_shown, 0]]
    return colors


def color_by_range(ranges_m: np.ndarray) -> np.ndarray:
    """Return BGR (n, 3) of returns at ranges (n,), from the nearest to the farthest."""
    span = np.ptp(ranges_m) if len(ranges_m) else 0.0
    share = (ranges_m - ranges_m.min()) / span if span > 0 else np.zeros(len(ranges_m))
    gradient = np.subtract(FARTHEST_BGR, NEAREST_BGR)
    return np.rint(np.array(NEAREST_BGR) + share[:, None] * gradient).astype(int)


def draw_points(image: np.ndarray, uv: np.ndarray, colors: np.ndarray) -> None:
    """Draw points at pixels uv (n, 2) into an image, in place, in colors (n, 3)."""
    for (u, v), color in zip(uv.tolist(), np.asarray(colors).tolist(), strict=False):
        cv2.circle(image, (u, v), 1, color, -1)
