"""A target in one lidar scan: clusters, the shape fitted to each, a score of position and size."""

from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from calib.geometry.pose_margin import angular_margin
from calib.geometry.se3 import transform_points
from calib.io.status import OK, Status, failure_status
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.target_shapes import TargetShape

N_EXTENT_DIRECTIONS = 36  # in the plane of the two widest axes; the extent is exact to 0.4 %
SIZE_WEIGHT = 4  # of the size error in the score: 1 is a quarter too large
MAX_SCORE = 2


def cluster_points(points: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the cluster number (n,) of points (n, 3): neighbours within tolerance join."""
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    n = len(points)
    links = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(links, directed=False)[1]


def largest_extent(points: np.ndarray) -> float:
    """Return the largest distance, m, between two of the points (n, 3)."""
    centred = points - points.mean(0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    angles = np.linspace(0, np.pi, N_EXTENT_DIRECTIONS, endpoint=False)
    directions = np.cos(angles)[:, None] * axes[0] + np.sin(angles)[:, None] * axes[1]
    return float(np.ptp(centred @ directions.T, axis=0).max())


def score_cluster(
    target: TargetShape,
    points: np.ndarray,
    T_sensor_target: np.ndarray,
    margin: np.ndarray,
    step: float,
) -> float:
    """Return how badly points (n, 3) fit the expected position and size; 0 is perfect.

    1 is the margin (6,) of the position used up, or a quarter too large, or as much too small after
    allowing the scan pattern one step, m, at both ends.
    """
    centre = transform_points(T_sensor_target, target.centre)
    distance = float(np.linalg.norm(centre))
    offset = float(np.linalg.norm(points.mean(0) - centre))
    position_error = float(offset / (angular_margin(margin, distance) * distance))
    return position_error + SIZE_WEIGHT * size_error(target, points, step)


def size_error(target: TargetShape, points: np.ndarray, step: float) -> float:
    """Return the share by which points (n, 3) are wider than the target, or narrower.

    Narrower ones are allowed one step, m, of the scan pattern at both ends.
    """
    found, expected = largest_extent(points), target.extents[0]
    if found >= expected:
        return found / expected - 1
    return max(0.0, 1 - (found + 2 * step) / expected)


def find_target_in_scan(
    target: TargetShape,
    points: np.ndarray,
    T_sensor_target: np.ndarray,
    margin: np.ndarray,
    *,
    lidar: LidarModel,
    options: dict[str, Any],
) -> tuple[np.ndarray, Status]:
    """Find the target in a scan's points (n, 3); return the indices of its returns, and a status.

    T_sensor_target: expected pose; margin (6,): how far it may be off; options: block `extract`.
    The returns are those on the fitted shape, without stand, hands or mixed returns at its rim.
    """
    near = _find_near_returns(target, points, T_sensor_target, margin)
    min_points = options["min_points"]
    if len(near) < min_points:
        status = failure_status("too few returns around the target", len(near), min_points)
        return near[:0], status
    distance = float(np.linalg.norm(transform_points(T_sensor_target, target.centre)))
    step = distance * max(lidar.azimuth_step, lidar.elevation_step)
    label = cluster_points(points[near], options["cluster_factor"] * step)
    best, best_score = near[:0], np.inf
    for k in range(label.max() + 1):
        inliers = _fit_cluster(
            target,
            points,
            near[label == k],
            T_sensor_target,
            margin,
            range_sigma=lidar.range_sigma,
            options=options,
        )
        if len(inliers) < min_points:
            continue
        score = score_cluster(target, points[inliers], T_sensor_target, margin, step)
        if score < best_score:
            best, best_score = inliers, score
    return best, _cluster_status(target, points[best], best_score, min_points)


def _find_near_returns(
    target: TargetShape, points: np.ndarray, T_sensor_target: np.ndarray, margin: np.ndarray
) -> np.ndarray:
    """Return the indices of the points (n, 3) that the target reaches within the margin (6,)."""
    centre = transform_points(T_sensor_target, target.centre)
    distance = float(np.linalg.norm(centre))
    reach = target.bounding_radius + angular_margin(margin, distance) * distance
    return np.flatnonzero(np.linalg.norm(points - centre, axis=1) < reach)


def _fit_cluster(
    target: TargetShape,
    points: np.ndarray,
    rows: np.ndarray,
    T_sensor_target: np.ndarray,
    margin: np.ndarray,
    *,
    range_sigma: float,
    options: dict[str, Any],
) -> np.ndarray:
    """Return those rows of points (n, 3) that lie on the target fitted to them.

    Empty if there are fewer than min_points (options) of them.
    """
    if len(rows) < options["min_points"]:
        return rows[:0]
    on_shape = target.fit_inliers(
        points[rows], T_sensor_target, margin, range_sigma=range_sigma, seed=options["seed"]
    )
    return rows[on_shape]


def _cluster_status(
    target: TargetShape, points: np.ndarray, score: float, min_points: int
) -> Status:
    """Return ok, or how the points (n, 3) of the best cluster differ from the target."""
    if len(points) == 0:
        return failure_status(
            f"no {target.name} among the clusters",
            "none of its shape",
            f"one with {min_points} returns on it or more",
        )
    if score > MAX_SCORE:
        return failure_status(
            f"no cluster like the {target.name}",
            f"{largest_extent(points):.2f} m wide, {len(points)} returns, score {score:.1f}",
            f"{target.extents[0]:.2f} m, score at most {MAX_SCORE}",
        )
    return OK
