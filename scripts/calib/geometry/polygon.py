"""Distances to and containment in a simple polygon of the plane.

An outline is (m, 2): its vertices in order, m, without repeating the first.
"""

import numpy as np


def signed_polygon_distance(vertices: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the distances (n,), m, of points p (n, 2) to the outline; negative inside."""
    x, y = p.T
    nearest = np.full(len(p), np.inf)
    for (ax, ay), (bx, by) in zip(vertices, np.roll(vertices, -1, 0), strict=True):
        dx, dy = bx - ax, by - ay
        fraction = np.clip(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0, 1)
        offset_x, offset_y = x - ax - fraction * dx, y - ay - fraction * dy
        nearest = np.minimum(nearest, offset_x * offset_x + offset_y * offset_y)
    nearest = np.sqrt(nearest)
    return np.where(polygon_contains(vertices, p), -nearest, nearest)


def polygon_contains(vertices: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return whether points p (n, 2) lie inside the outline, (n,) bool, by ray casting."""
    x, y = p.T
    inside = np.zeros(len(p), bool)
    for (ax, ay), (bx, by) in zip(vertices, np.roll(vertices, -1, 0), strict=True):
        if ay != by:
            inside ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) / (by - ay) * (bx - ax))
    return inside


def nearest_polygon_edge(
    vertices: np.ndarray, p: np.ndarray, edge: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the index (n,) of the edge nearest to each point p (n, 2), and the position along it.

    The position (n,) is the fraction from the edge's first vertex to its second, not clipped.
    edge: (n,) indices to use instead of the nearest edges.
    """
    along = np.roll(vertices, -1, 0) - vertices
    offset = p[:, None, :] - vertices
    fraction = (offset * along).sum(-1) / (along * along).sum(-1)
    if edge is None:
        clipped = np.clip(fraction, 0, 1)
        edge = np.linalg.norm(offset - clipped[..., None] * along, axis=-1).argmin(1)
    return edge, fraction[np.arange(len(p)), edge]


def sample_polygon_outline(vertices: np.ndarray, spacing: float) -> np.ndarray:
    """Return points (n, 2) on the outline, at most `spacing` (m) apart."""
    sides = np.roll(vertices, -1, 0) - vertices
    counts = np.ceil(np.linalg.norm(sides, axis=1) / spacing).astype(int)
    steps = [
        a + np.arange(n)[:, None] / n * s for a, s, n in zip(vertices, sides, counts, strict=True)
    ]
    return np.concatenate(steps)
