"""Signed distances to a simple polygon in the plane."""

import numpy as np


def signed_polygon_distance(vertices, p):
    """Distance (n,), m, of points p (n, 2) to the outline (m, 2): negative inside."""
    x, y = p.T
    nearest = np.full(len(p), np.inf)
    for (ax, ay), (bx, by) in zip(vertices, np.roll(vertices, -1, 0), strict=True):
        dx, dy = bx - ax, by - ay
        fraction = np.clip(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0, 1)
        away_x, away_y = x - ax - fraction * dx, y - ay - fraction * dy
        nearest = np.minimum(nearest, away_x * away_x + away_y * away_y)
    nearest = np.sqrt(nearest)
    return np.where(polygon_contains(vertices, p), -nearest, nearest)


def polygon_contains(vertices, p):
    """Whether points p (n, 2) lie inside the outline (m, 2), by counting crossings."""
    x, y = p.T
    inside = np.zeros(len(p), bool)
    for (ax, ay), (bx, by) in zip(vertices, np.roll(vertices, -1, 0), strict=True):
        if ay != by:
            inside ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) / (by - ay) * (bx - ax))
    return inside


def nearest_polygon_edge(vertices, p, edge=None):
    """Index (n,) of the outline edge nearest to p (n, 2), and the fraction (n,) along its line.

    edge (n,): edges to use instead of the nearest.
    """
    along = np.roll(vertices, -1, 0) - vertices
    offset = p[:, None, :] - vertices
    free = (offset * along).sum(-1) / (along * along).sum(-1)
    if edge is None:
        clipped = np.clip(free, 0, 1)
        edge = np.linalg.norm(offset - clipped[..., None] * along, axis=-1).argmin(1)
    return edge, free[np.arange(len(p)), edge]


def sample_polygon_outline(vertices, spacing):
    """Points (n, 2) on the outline (m, 2), spacing m apart or a little less."""
    sides = np.roll(vertices, -1, 0) - vertices
    counts = np.ceil(np.linalg.norm(sides, axis=1) / spacing).astype(int)
    steps = [
        a + np.arange(n)[:, None] / n * s for a, s, n in zip(vertices, sides, counts, strict=True)
    ]
    return np.concatenate(steps)
