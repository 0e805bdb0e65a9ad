"""Contour pixels against the nearest point of the template's silhouette; paper III-D."""

import numpy as np
from scipy.spatial import cKDTree

from calib.estimation.residuals import pattern_corner
from calib.estimation.residuals.assignment import Assignment
from calib.geometry.se3 import transform_points

UNIT, MIN_SIGMA = "px", 1e-2
DATA_COLUMNS = pattern_corner.DATA_COLUMNS
CELLS_PER_SPACING = 2  # cells per projected spacing of the template
MAX_RASTER_CELLS = 4000  # along the raster
ISOTROPIC_WHITENING = (1.0, 0.0, 1.0)  # u and v are: the corner's whitening


def assign(camera, target, T_sensor_target, keypoints, options, noise, features=None):
    """Every contour pixel with the nearest point of the silhouette at the current pose.

    features (n,): template point of each where it was assigned before, -1 for none.
    """
    if features is None:
        return _assign_silhouette(camera, target, T_sensor_target, keypoints, options, noise, 0.0)
    predicted, _ = camera.project(transform_points(T_sensor_target, target.point_template.xyz))
    offset = keypoints["uv"] - predicted[features]
    return _make_assignment(target, T_sensor_target, keypoints, options, noise, features, offset)


def assign_first(camera, target, T_sensor_target, keypoints, options, noise):
    """As assign, with the centroids of both contours laid on each other."""
    outline, uv = _project_silhouette(camera, target, T_sensor_target)
    shift = uv.mean(0) - keypoints["uv"].mean(0) if len(outline) else 0.0
    return _assign_silhouette(camera, target, T_sensor_target, keypoints, options, noise, shift)


def _assign_silhouette(camera, target, T_sensor_target, keypoints, options, noise, shift):
    outline, uv = _project_silhouette(camera, target, T_sensor_target)
    n = len(keypoints["view"])
    point, value = np.full(n, -1), np.zeros((n, 2))
    if len(outline):
        reach = options["gate_sigma"] * noise.total * keypoints["sigma"]
        distance, near = cKDTree(uv).query(keypoints["uv"] + shift)
        value = keypoints["uv"] - uv[near]
        point = np.where(distance < reach, outline[near], -1)
    return _make_assignment(target, T_sensor_target, keypoints, options, noise, point, value)


def _make_assignment(target, T_sensor_target, keypoints, options, noise, point, value):
    n = len(point)
    at = target.point_template.xyz[point]
    return Assignment(
        candidate_feature=point,
        geometric_weight=np.ones(n),
        repeat_group=np.arange(n),
        keypoint_sigma=keypoints["sigma"],
        residual=value,
        range=np.linalg.norm(transform_points(T_sensor_target, at), axis=1),
        cos_incidence=np.zeros(n),
        data=np.column_stack([keypoints["uv"], at, np.tile(ISOTROPIC_WHITENING, (n, 1))]),
        noise=noise,
        gate_sigma=options["gate_sigma"],
    )


def _project_silhouette(camera, target, T_sensor_target):
    """Indices (m,) of the template points on the rim of their own projection, and pixels (m, 2)."""
    uv, valid = camera.project(transform_points(T_sensor_target, target.point_template.xyz))
    rows = np.flatnonzero(valid & camera.is_in_image(uv))
    if len(rows) < 3:
        return rows[:0], np.zeros((0, 2))
    near = target.point_template.nearest_neighbour[rows]
    spacing = np.median(np.linalg.norm(uv[near] - uv[rows], axis=1)[valid[near]])
    index = find_rim_points(uv[rows], float(spacing))
    return rows[index], uv[rows][index]


def find_rim_points(uv, spacing):
    """Indices of the points (n, 2) on the outer rim of the area that they cover, spacing px apart.

    The points are drawn as discs of four spacings; the rim of what those cover lies one radius
    outside that of the points, and the point nearest to each cell of it is taken.
    """
    import cv2  # 0.2 s, which only jobs that draw should pay

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


residual = pattern_corner.residual
