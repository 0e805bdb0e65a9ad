"""Find what may be a target anywhere in a scan: things of its shape and size."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from calib.geometry.ransac_plane import largest_plane_inliers
from calib.geometry.se3 import make_pose, rotation_between
from calib.sensors.lidar.lidar_model import LidarModel
from calib.sensors.lidar.target_search import cluster_points, largest_extent, size_error
from calib.targets.target_shapes import TargetShape

THINNING_STEP_RAD = np.deg2rad(0.6)  # between the returns that are searched
MAX_GAP_STEPS = 1.5  # steps of the scan pattern between two returns of one thing
MIN_CANDIDATE_RETURNS = 8
RETURN_COUNT_RATIOS = (0.35, 2.0)  # returns over those expected from the target's area
MAX_SIZE_ERROR = 0.4
LARGE_CLUSTER_FACTOR = 2.5  # extents of the target above which a cluster is a wall or floor
MAX_PLANE_REMOVALS = 4
ANY_POSE_MARGIN = np.full(6, np.pi)  # margin of an unknown pose
MAX_FLAT_RATIO = 0.25  # smallest over middle spread of a flat shape
MIN_LONG_RATIO = 1.5  # largest over middle spread of a long shape
N_PLANE_DRAWS = 200
PLANE_DISTANCE_SHARE = 0.02  # of the range: returns nearer than this are on a plane


@dataclass(frozen=True)
class ShapeSignature:
    """What a scan shows of a shape's pose.

    centre: (3,), target frame, m. direction: (3,) unit vector, target frame, along the least
    (axis_index 0) or largest (2) spread. has_direction: whether that axis is distinct. has_sign:
    whether its sign can be seen.
    """

    centre: np.ndarray
    direction: np.ndarray
    axis_index: int
    has_direction: bool
    has_sign: bool

    @classmethod
    def from_target(cls, target: TargetShape) -> "ShapeSignature":
        """Compute it from points all over the surface."""
        axes = principal_axes(target.sample_surface(target.extents[0] / 50))
        is_flat = axes.spreads[0] < MAX_FLAT_RATIO * axes.spreads[1]
        is_long = axes.spreads[2] > MIN_LONG_RATIO * axes.spreads[1]
        axis_index = 0 if is_flat else 2
        direction = axes.vectors[:, axis_index]
        is_seen = [target.check_facing(target.centre + s * 1e3 * direction)[0] for s in (1, -1)]
        direction = direction if is_seen[0] else -direction
        return cls(
            centre=target.centre,
            direction=direction,
            axis_index=axis_index,
            has_direction=is_flat or is_long,
            has_sign=is_seen[0] != is_seen[1],
        )


class PrincipalAxes(NamedTuple):
    """Spreads (3,), m, increasing, and their unit vectors as columns (3, 3)."""

    spreads: np.ndarray
    vectors: np.ndarray


class TargetCandidate(NamedTuple):
    """Centre (3,), m, and direction (3,) of what may be a target, lidar frame."""

    centre: np.ndarray
    direction: np.ndarray


def principal_axes(points: np.ndarray) -> PrincipalAxes:
    """Return the principal axes of points (n, 3), m."""
    values, vectors = np.linalg.eigh(np.cov(points.T))
    return PrincipalAxes(np.sqrt(np.maximum(values, 0)), vectors)


def thin_scan(lidar: LidarModel, xyz: np.ndarray) -> np.ndarray:
    """Return the first of the points (n, 3) in range per direction cell of THINNING_STEP_RAD."""
    ranges = np.linalg.norm(xyz, axis=1)
    xyz = xyz[(ranges > lidar.range_limits[0]) & (ranges < lidar.range_limits[1])]
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    elevation = np.arctan2(xyz[:, 2], np.linalg.norm(xyz[:, :2], axis=1))
    cell = np.floor(np.column_stack([azimuth, elevation]) / THINNING_STEP_RAD).astype(int)
    return xyz[np.sort(np.unique(cell, axis=0, return_index=True)[1])]


def angular_steps(lidar: LidarModel) -> tuple[float, float]:
    """Return the angles, rad, between thinned returns along azimuth and elevation."""
    return max(lidar.azimuth_step, THINNING_STEP_RAD), max(lidar.elevation_step, THINNING_STEP_RAD)


def split_clusters(
    points: np.ndarray, step: float, width: float, rng: np.random.Generator
) -> list[np.ndarray]:
    """Return index arrays of connected points (n, 3) without a gap over MAX_GAP_STEPS steps, rad.

    A cluster much wider than `width`, m, is a wall or floor, possibly with things on it: its
    largest plane is removed, and the rest is clustered again.
    """
    to_split, clusters = [(np.arange(len(points)), 0)], []
    while to_split:
        rows, n_removals = to_split.pop()
        ranges = np.linalg.norm(points[rows], axis=1)
        # In these coordinates lengths are relative to the range, like the gaps between beams.
        relative = np.column_stack([points[rows] / ranges[:, None], np.log(ranges)])
        label = cluster_points(relative, MAX_GAP_STEPS * step)
        order = np.argsort(label, kind="stable")
        for part in np.split(rows[order], np.cumsum(np.bincount(label))[:-1]):
            if len(part) < MIN_CANDIDATE_RETURNS:
                continue
            if largest_extent(points[part]) < LARGE_CLUSTER_FACTOR * width:
                clusters.append(part)
            elif n_removals < MAX_PLANE_REMOVALS:
                rest = part[~is_on_largest_plane(points[part], rng)]
                to_split.append((rest, n_removals + 1))
    return [part for part in clusters if len(part) >= MIN_CANDIDATE_RETURNS]


def is_on_largest_plane(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return which points (n, 3) are on the plane that holds most of them."""
    tolerance = PLANE_DISTANCE_SHARE * np.linalg.norm(points, axis=1)
    return largest_plane_inliers(points, tolerance, rng, n_draws=N_PLANE_DRAWS)


def find_candidates(
    lidar: LidarModel,
    target: TargetShape,
    signature: ShapeSignature,
    points: np.ndarray,
    options: dict[str, Any],
) -> list[TargetCandidate]:
    """Return what may be the target in thinned points (n, 3). options: block `guess`."""
    rng = np.random.default_rng(options["seed"])
    candidates = []
    for rows in split_clusters(points, max(angular_steps(lidar)), target.extents[0], rng):
        if is_too_small(lidar, target, points[rows]):
            continue
        inliers = fit_candidate(lidar, target, signature, points[rows], options)
        if len(inliers) and matches_target(lidar, target, signature, inliers):
            candidates.append(measure_candidate(target, signature, inliers))
    return candidates


def fit_candidate(
    lidar: LidarModel,
    target: TargetShape,
    signature: ShapeSignature,
    points: np.ndarray,
    options: dict[str, Any],
) -> np.ndarray:
    """Return the points (m, 3) of a cluster (n, 3) that the shape explains in its best attitude.

    Only the largest connected part is returned; empty if it is too small.
    """
    best = points[:0]
    for T in candidate_poses(signature, points):
        rows = target.fit_inliers(
            points, T, ANY_POSE_MARGIN, range_sigma=lidar.range_sigma, seed=options["seed"]
        )
        best = points[rows] if len(rows) > len(best) else best
    if len(best) < MIN_CANDIDATE_RETURNS:
        return points[:0]
    gap = float(MAX_GAP_STEPS * max(angular_steps(lidar)) * np.linalg.norm(best.mean(0)))
    label = cluster_points(best, gap)
    best = best[label == np.bincount(label).argmax()]
    return best if len(best) >= MIN_CANDIDATE_RETURNS else points[:0]


def candidate_poses(signature: ShapeSignature, points: np.ndarray) -> list[np.ndarray]:
    """Return poses (4, 4) at the centroid of points (n, 3), with the shape's direction along them.

    The direction is along their principal axis; along each of the three axes if a long shape may be
    connected with something else.
    """
    axes = principal_axes(points)
    is_clear = signature.axis_index == 0 or axes.spreads[2] > MIN_LONG_RATIO * axes.spreads[1]
    return [
        make_pose(rotation_between(signature.direction, axes.vectors[:, k]), points.mean(0))
        for k in ((signature.axis_index,) if is_clear else (0, 1, 2))
    ]


def is_too_small(lidar: LidarModel, target: TargetShape, points: np.ndarray) -> bool:
    """Return whether points (n, 3) extend less than the target, within a step at both ends."""
    step = max(angular_steps(lidar)) * np.linalg.norm(points.mean(0))
    return bool(largest_extent(points) + 2 * step < (1 - MAX_SIZE_ERROR) * target.extents[0])


def matches_target(
    lidar: LidarModel, target: TargetShape, signature: ShapeSignature, inliers: np.ndarray
) -> bool:
    """Return whether inliers (n, 3) have the target's size and expected number of returns."""
    centre = inliers.mean(0)
    distance = np.linalg.norm(centre)
    step = float(max(angular_steps(lidar)) * distance)
    if size_error(target, inliers, step) > MAX_SIZE_ERROR:
        return False
    along = principal_axes(inliers).vectors[:, signature.axis_index] @ centre / distance
    cosine = abs(along) if signature.axis_index == 0 else np.sqrt(1 - along**2)
    expected = target.area * cosine / distance**2 / np.prod(angular_steps(lidar))
    return bool(RETURN_COUNT_RATIOS[0] < len(inliers) / expected < RETURN_COUNT_RATIOS[1])


def measure_candidate(
    target: TargetShape, signature: ShapeSignature, inliers: np.ndarray
) -> TargetCandidate:
    """Return centre and direction of a target whose visible returns are inliers (n, 3)."""
    centre = inliers.mean(0)
    beam = centre / np.linalg.norm(centre)
    direction = principal_axes(inliers).vectors[:, signature.axis_index]
    if signature.axis_index == 0:
        return TargetCandidate(centre, -np.copysign(1, direction @ beam) * direction)
    # Returns evenly spread in angle have their centroid π/4 radii in front of the axis.
    return TargetCandidate(centre + np.pi / 8 * target.extents[1] * beam, direction)
