"""The plane that most points lie on, by random sampling (RANSAC)."""

import numpy as np

MIN_TRIANGLE_M2 = 1e-6  # twice the area of three drawn points; smaller ones define no plane


def largest_plane_inliers(
    points: np.ndarray,
    tolerance: float | np.ndarray,
    rng: np.random.Generator,
    *,
    n_draws: int,
    normal: np.ndarray | None = None,
    min_cosine: float = 0.0,
) -> np.ndarray:
    """Return which points (n, 3), m, lie on the plane with the most inliers.

    n_draws planes through three random points compete. tolerance: largest distance of an inlier, m,
    one number or (n,). With a normal (3,), planes whose normal has a smaller absolute cosine to it
    than min_cosine are left out. If no plane is left, no point is an inlier.
    """
    triples = points[rng.integers(0, len(points), (n_draws, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(length, 1e-12)[:, None]
    offsets = np.sum(normals * triples[:, 0], 1)
    is_inlier = np.abs(points @ normals.T - offsets) < np.reshape(tolerance, (-1, 1))
    is_candidate = length > MIN_TRIANGLE_M2
    if normal is not None:
        is_candidate &= np.abs(normals @ normal) > min_cosine
    votes = np.where(is_candidate, is_inlier.sum(0), 0)
    winner = votes.argmax()
    return is_inlier[:, winner] & (votes[winner] > 0)
