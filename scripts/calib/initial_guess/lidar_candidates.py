"""What in a scan may be a target, wherever it is: things of its shape and size."""

from dataclasses import dataclass

import numpy as np

from calib.geometry.se3 import make_pose, rotation_between
from calib.sensors.lidar.target_search import cluster_points, largest_extent, size_error

THINNING_STEP_RAD = np.deg2rad(0.6)  # between the returns that are looked at
MAX_GAP_STEPS = 1.5  # steps of the scan pattern between two returns of one thing
MIN_CANDIDATE_RETURNS = 8  # returns of a candidate
RETURN_COUNT_RATIOS = (0.35, 2.0)  # of the returns that a target's area lets expect
MAX_SIZE_ERROR = 0.4
LARGE_CLUSTER_FACTOR, MAX_PLANE_REMOVALS = (
    2.5,
    4,
)  # targets that a cluster is wide from which on planes are taken out of it
ANY_POSE_MARGIN = np.full(6, np.pi)  # margin of a pose that says nothing
MAX_FLAT_RATIO, MIN_LONG_RATIO = (
    0.25,
    1.5,
)  # least spread over the middle one, largest over the middle one
N_PLANE_DRAWS = 200


@dataclass(frozen=True)
class ShapeSignature:
    """What a scan tells of a shape's pose: its centre (3,), and the direction (3,) of its least
    (0) or largest (2) spread, target frame; whether it has one, and a sign that can be seen."""

    centre: np.ndarray
    direction: np.ndarray
    axis_index: int
    has_direction: bool
    has_sign: bool

    @classmethod
    def from_target(cls, target):
        values, vectors = principal_axes(target.sample_surface(target.extents[0] / 50))
        flat, long = values[0] < MAX_FLAT_RATIO * values[1], values[2] > MIN_LONG_RATIO * values[1]
        spread = 0 if flat else 2
        n = vectors[:, spread]
        seen = [target.check_facing(target.centre + s * 1e3 * n)[0] for s in (1, -1)]
        n = n if seen[0] else -n
        return cls(target.centre, n, spread, flat or long, seen[0] != seen[1])


def principal_axes(points):
    """Spreads (3,), m, upwards, and unit axes (3, 3) in columns, of points (n, 3)."""
    values, vectors = np.linalg.eigh(np.cov(points.T))
    return np.sqrt(np.maximum(values, 0)), vectors


def thin_scan(lidar, xyz):
    """The points (m, 3) of xyz (n, 3) in reach, the first of each THIN by THIN of direction."""
    ranges = np.linalg.norm(xyz, axis=1)
    xyz = xyz[(ranges > lidar.range_limits[0]) & (ranges < lidar.range_limits[1])]
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    elevation = np.arctan2(xyz[:, 2], np.linalg.norm(xyz[:, :2], axis=1))
    cell = np.floor(np.column_stack([azimuth, elevation]) / THINNING_STEP_RAD).astype(int)
    return xyz[np.sort(np.unique(cell, axis=0, return_index=True)[1])]


def angular_steps(lidar):
    """Angles, rad, between thinned returns along azimuth and elevation."""
    return max(lidar.azimuth_step, THINNING_STEP_RAD), max(lidar.elevation_step, THINNING_STEP_RAD)


def split_clusters(points, step, width, rng):
    """Index arrays of points (n, 3) that hang together: no gap wider than LINK steps, rad.

    What is much wider than `width`, m, is a wall or floor, maybe with things on it: its largest
    plane is taken out, and the rest looked at again.
    """
    todo, out = [(np.arange(len(points)), 0)], []
    while todo:
        rows, peeled = todo.pop()
        ranges = np.linalg.norm(points[rows], axis=1)
        # In these coordinates lengths are shares of the range, as the gaps between beams are.
        relative = np.column_stack([points[rows] / ranges[:, None], np.log(ranges)])
        label = cluster_points(relative, MAX_GAP_STEPS * step)
        order = np.argsort(label, kind="stable")
        for part in np.split(rows[order], np.cumsum(np.bincount(label))[:-1]):
            if len(part) < MIN_CANDIDATE_RETURNS:
                continue
            if largest_extent(points[part]) < LARGE_CLUSTER_FACTOR * width:
                out.append(part)
            elif peeled < MAX_PLANE_REMOVALS:
                todo.append((part[~is_on_largest_plane(points[part], rng)], peeled + 1))
    return [part for part in out if len(part) >= MIN_CANDIDATE_RETURNS]


def is_on_largest_plane(points, rng):
    """Which points (n, 3) lie within 2 % of their range of the plane that holds most of them."""
    triples = points[rng.integers(0, len(points), (N_PLANE_DRAWS, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
    away = np.abs(points @ normals.T - np.sum(normals * triples[:, 0], 1))
    inside = away < 0.02 * np.linalg.norm(points, axis=1)[:, None]
    return inside[:, inside.sum(0).argmax()]


def find_candidates(lidar, target, signature, points, options):
    """[(centre (3,), direction (3,))], lidar frame, of what may be the target in thinned points."""
    rng = np.random.default_rng(options["seed"])
    out = []
    for rows in split_clusters(points, max(angular_steps(lidar)), target.extents[0], rng):
        if is_too_small(lidar, target, points[rows]):
            continue
        members = fit_candidate(lidar, target, signature, points[rows], options)
        if len(members) and matches_target(lidar, target, signature, members):
            out.append(measure_candidate(target, signature, members))
    return out


def fit_candidate(lidar, target, signature, points, options):
    """The points (m, 3) of one thing (n, 3) that the shape explains, in its best attitude, without
    what hangs on by less than a step."""
    best = points[:0]
    for T in candidate_poses(signature, points):
        rows = target.fit_inliers(points, T, ANY_POSE_MARGIN, lidar, options)
        best = points[rows] if len(rows) > len(best) else best
    if len(best) < MIN_CANDIDATE_RETURNS:
        return points[:0]
    gap = MAX_GAP_STEPS * max(angular_steps(lidar)) * np.linalg.norm(best.mean(0))
    label = cluster_points(best, gap)
    best = best[label == np.bincount(label).argmax()]
    return best if len(best) >= MIN_CANDIDATE_RETURNS else points[:0]


def candidate_poses(signature, points):
    """[T (4, 4)] at the middle of the points (n, 3), with the shape's direction along their main
    axes: along any where a long shape may hang on something else."""
    values, axes = principal_axes(points)
    clear = signature.axis_index == 0 or values[2] > MIN_LONG_RATIO * values[1]
    return [
        make_pose(rotation_between(signature.direction, axes[:, k]), points.mean(0))
        for k in ((signature.axis_index,) if clear else (0, 1, 2))
    ]


def is_too_small(lidar, target, points):
    """Whether a thing's points (n, 3) do not reach as far as the target, give or take a step."""
    step = max(angular_steps(lidar)) * np.linalg.norm(points.mean(0))
    return largest_extent(points) + 2 * step < (1 - MAX_SIZE_ERROR) * target.extents[0]


def matches_target(lidar, target, signature, inliers):
    """Whether inliers (n, 3) have the size of the target and as many returns as it would give."""
    centre = inliers.mean(0)
    distance = np.linalg.norm(centre)
    step = max(angular_steps(lidar)) * distance
    if size_error(target, inliers, step) > MAX_SIZE_ERROR:
        return False
    along = principal_axes(inliers)[1][:, signature.axis_index] @ centre / distance
    cosine = abs(along) if signature.axis_index == 0 else np.sqrt(1 - along**2)
    expected = target.area * cosine / distance**2 / np.prod(angular_steps(lidar))
    return RETURN_COUNT_RATIOS[0] < len(inliers) / expected < RETURN_COUNT_RATIOS[1]


def measure_candidate(target, signature, inliers):
    """(centre (3,), direction (3,)), lidar frame, of a target whose visible returns are members."""
    centre = inliers.mean(0)
    beam = centre / np.linalg.norm(centre)
    direction = principal_axes(inliers)[1][:, signature.axis_index]
    if signature.axis_index == 0:
        return centre, -np.copysign(1, direction @ beam) * direction
    # Returns evenly spread in angle have their centroid π/4 radii before the axis.
    return centre + np.pi / 8 * target.extents[1] * beam, direction
