"""Contour pixels against the nearest point of the template's silhouette; paper III-D.

Residual: as of pattern_corner, of a template point on the rim of its own projection.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from calib.estimation.residuals import pattern_corner
from calib.estimation.residuals.assignment import Assignment, Keypoints, Noise
from calib.geometry.se3 import transform_points
from calib.sensors.camera.camera_model import CameraModel

UNIT, MIN_SIGMA = "px", 1e-2
DATA_COLUMNS = pattern_corner.DATA_COLUMNS
USES_TEMPLATE_POINTS = True
CELLS_PER_SPACING = 2  # raster cells per projected spacing of the template
MAX_RASTER_CELLS = 4000  # along the raster
ISOTROPIC_WHITENING = (1.0, 0.0, 1.0)  # a, b, c of pattern_corner

residual = pattern_corner.residual


class NearestPoints(NamedTuple):
    """Template points (n,) that pixels are assigned to, -1 for none, and the offsets (n, 2), px."""

    features: np.ndarray
    offset: np.ndarray


def assign(
    model: CameraModel,
    target: Any,
    T_sensor_target: np.ndarray,
    keypoints: Keypoints,
    *,
    options: Mapping[str, Any],
    noise: Noise,
    features: np.ndarray | None = None,
) -> Assignment:
    """Assign every contour pixel to the nearest point of the silhouette at the current pose.

    features: points of the template.
    """
    if features is None:
        silhouette = _project_silhouette(model, target, T_sensor_target)
        reach = options["gate_sigma"] * noise.total * keypoints["sigma"]
        nearest = _find_nearest(*silhouette, keypoints["uv"], reach=reach, shift=0.0)
    else:
        uv, _ = model.project(transform_points(T_sensor_target, target.point_template.xyz))
        nearest = NearestPoints(features, keypoints["uv"] - uv[features])
    points = target.point_template.xyz[nearest.features]
    return _make_assignment(
        points, T_sensor_target, keypoints, nearest=nearest, options=options, noise=noise
    )


def assign_first(
    model: CameraModel,
    target: Any,
    T_sensor_target: np.ndarray,
    keypoints: Keypoints,
    *,
    options: Mapping[str, Any],
    noise: Noise,
) -> Assignment:
    """Assign as assign does, with the centroids of both contours laid on each other."""
    rows, uv = _project_silhouette(model, target, T_sensor_target)
    shift = uv.mean(0) - keypoints["uv"].mean(0) if len(rows) else 0.0
    reach = options["gate_sigma"] * noise.total * keypoints["sigma"]
    nearest = _find_nearest(rows, uv, keypoints["uv"], reach=reach, shift=shift)
    points = target.point_template.xyz[nearest.features]
    return _make_assignment(
        points, T_sensor_target, keypoints, nearest=nearest, options=options, noise=noise
    )


def _find_nearest(
    rows: np.ndarray,
    uv: np.ndarray,
    measured: np.ndarray,
    *,
    reach: np.ndarray,
    shift: np.ndarray | float,
) -> NearestPoints:
    """Find the nearest of the pixels uv (m, 2) of template points rows (m,) to measured (n, 2).

    reach (n,): px; shift (2,): added to the measured pixels for the search alone.
    """
    if not len(rows):
        return NearestPoints(np.full(len(measured), -1), np.zeros((len(measured), 2)))
    distance, near = cKDTree(uv).query(measured + shift)
    return NearestPoints(np.where(distance < reach, rows[near], -1), measured - uv[near])


def _make_assignment(
    points: np.ndarray,
    T_sensor_target: np.ndarray,
    keypoints: Keypoints,
    *,
    nearest: NearestPoints,
    options: Mapping[str, Any],
    noise: Noise,
) -> Assignment:
    """Return the Assignment of pixels to template points (n, 3), target frame."""
    n = len(points)
    return Assignment(
        candidate_feature=nearest.features,
        geometric_weight=np.ones(n),
        repeat_group=np.arange(n),
        keypoint_sigma=keypoints["sigma"],
        residual=nearest.offset,
        range=np.linalg.norm(transform_points(T_sensor_target, points), axis=1),
        cos_incidence=np.zeros(n),
        data=np.column_stack([keypoints["uv"], points, np.tile(ISOTROPIC_WHITENING, (n, 1))]),
        noise=noise,
        gate_sigma=options["gate_sigma"],
    )


def _project_silhouette(
    camera: CameraModel, target: Any, T_sensor_target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the template points (m,) on the rim of their own projection, and pixels (m, 2)."""
    uv, valid = camera.project(transform_points(T_sensor_target, target.point_template.xyz))
    rows = np.flatnonzero(valid & camera.is_in_image(uv))
    if len(rows) < 3:
        return rows[:0], np.zeros((0, 2))
    near = target.point_template.nearest_neighbour[rows]
    spacing = np.median(np.linalg.norm(uv[near] - uv[rows], axis=1)[valid[near]])
    index = find_rim_points(uv[rows], float(spacing))
    return rows[index], uv[rows][index]


def find_rim_points(uv: np.ndarray, spacing: float) -> np.ndarray:
    """Return the indices (m,) of the points uv (n, 2) on the outer rim of the area they cover.

    The points, about `spacing` px apart, are drawn as discs of four spacings. The rim of these
    discs lies one radius outside that of the points: the point nearest to each cell of it is taken.
    """
    import cv2  # takes 0.2 s to load

    cell = max(spacing / CELLS_PER_SPACING, np.ptp(uv, axis=0).max() / MAX_RASTER_CELLS)
    radius = int(np.ceil(4 * spacing / cell)) + 1
    at = (uv - uv.min(0)) / cell + radius + 1
    grid = np.rint(at).astype(int)
    covered = np.zeros(grid.max(0)[::-1] + radius + 2, np.uint8)
    covered[grid[:, 1], grid[:, 0]] = 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    covered = cv2.dilate(covered, disc)
    contours, _ = cv2.findContours(covered, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outer = max(contours, key=len)[:, 0].astype(float)
    return np.unique(cKDTree(at).query(outer)[1])
