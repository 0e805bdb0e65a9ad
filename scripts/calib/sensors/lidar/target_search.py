"""A target in one lidar scan: clusters, the shape fitted to each, a score of place and size."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from calib.geometry.pose_margin import angular_margin
from calib.geometry.se3 import transform_points
from calib.io.status import OK, failure_status


def cluster_points(points, tolerance):
    """Cluster number (n,) of points (n, 3): neighbours within tolerance, m, belong together."""
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    n = len(points)
    linked = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(linked, directed=False)[1]


def largest_extent(points):
    """Largest distance, m, between two of the points (n, 3)."""
    centred = points - points.mean(0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    # The ends along a few dozen directions in the two widest axes; exact to 0.4 %.
    angles = np.linspace(0, np.pi, 36, endpoint=False)
    directions = np.cos(angles)[:, None] * axes[0] + np.sin(angles)[:, None] * axes[1]
    return np.ptp(centred @ directions.T, axis=0).max()


def score_cluster(target, points, T_sensor_target, margin, step):
    """How badly points (n, 3) fit the expected place (in 3-D) and size; 0 is perfect.

    1 is the place's margin used up, or a quarter too large, or as much too small after allowing
    the scan pattern one step, m, at both ends.
    """
    centre = transform_points(T_sensor_target, target.centre)
    distance = np.linalg.norm(centre)
    place = np.linalg.norm(points.mean(0) - centre) / (angular_margin(margin, distance) * distance)
    return place + 4 * size_error(target, points, step)


def size_error(target, points, step):
    """Share by which points (n, 3) reach wider than the target, or less wide although the scan
    pattern is allowed one step, m, at both ends."""
    found, expected = largest_extent(points), target.extents[0]
    if found >= expected:
        return found / expected - 1
    return max(0.0, 1 - (found + 2 * step) / expected)


def find_target_in_scan(target, points, T_sensor_target, margin, lidar, options):
    """The target in a scan's points (n, 3): (indices of its returns, status).

    T_sensor_target and margin (6,) say where it may be. The indices are those the fitted plane or
    cylinder explains, without stand, hands or the mixed returns at its rim.
    """
    centre = transform_points(T_sensor_target, target.centre)
    distance = np.linalg.norm(centre)
    slack = angular_margin(margin, distance) * distance
    near = np.flatnonzero(np.linalg.norm(points - centre, axis=1) < target.bounding_radius + slack)
    if len(near) < options["min_points"]:
        return near[:0], failure_status(
            "too few returns around the target", len(near), options["min_points"]
        )
    step = distance * max(lidar.azimuth_step, lidar.elevation_step)
    label = cluster_points(points[near], options["cluster_factor"] * step)
    best, best_score = near[:0], np.inf
    for k in range(label.max() + 1):
        rows = near[label == k]
        if len(rows) < options["min_points"]:
            continue
        members = rows[
            target.fit_inliers(
                points[rows],
                T_sensor_target,
                margin,
                range_sigma=lidar.range_sigma,
                seed=options["seed"],
            )
        ]
        if len(members) < options["min_points"]:
            continue
        value = score_cluster(target, points[members], T_sensor_target, margin, step)
        if value < best_score:
            best, best_score = members, value
    return best, _cluster_status(target, points, best, best_score, options)


def _cluster_status(target, points, best, value, options):
    """Ok, or what the best cluster was and should have been."""
    if len(best) == 0:
        return failure_status(
            f"no {target.name} among the clusters",
            "none of its shape",
            f"one with {options['min_points']} returns on it or more",
        )
    if value > 2:
        found = f"{largest_extent(points[best]):.2f} m wide, {len(best)} returns, score {value:.1f}"
        return failure_status(
            f"no cluster like the {target.name}",
            found,
            f"{target.extents[0]:.2f} m, score at most 2",
        )
    return OK
