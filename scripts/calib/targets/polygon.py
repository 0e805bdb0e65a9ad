"""Signed distances to a simple polygon in the plane."""

import numpy as np


def signed_distance(vertices, p):
    """Distance (n,), m, of points p (n, 2) to the outline (m, 2): negative inside."""
    start, along = vertices, np.roll(vertices, -1, 0) - vertices
    offset = p[:, None, :] - start
    fraction = np.clip((offset * along).sum(-1) / (along * along).sum(-1), 0, 1)
    nearest = np.linalg.norm(offset - fraction[..., None] * along, axis=-1).min(1)
    return np.where(contains(vertices, p), -nearest, nearest)


def contains(vertices, p):
    """Whether points p (n, 2) lie inside the outline (m, 2), by counting crossings."""
    a, b = vertices, np.roll(vertices, -1, 0)
    y = p[:, None, 1]
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    rise = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
    x = a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
    return (crosses & (p[:, None, 0] < x)).sum(1) % 2 == 1


def nearest_edge(vertices, p):
    """Index (n,) of the outline edge nearest to p (n, 2), and the fraction (n,) along its line."""
    along = np.roll(vertices, -1, 0) - vertices
    offset = p[:, None, :] - vertices
    free = (offset * along).sum(-1) / (along * along).sum(-1)
    clipped = np.clip(free, 0, 1)
    edge = np.linalg.norm(offset - clipped[..., None] * along, axis=-1).argmin(1)
    return edge, free[np.arange(len(p)), edge]


def along(vertices, spacing):
    """Points (n, 2) on the outline (m, 2), spacing m apart or a little less."""
    sides = np.roll(vertices, -1, 0) - vertices
    counts = np.ceil(np.linalg.norm(sides, axis=1) / spacing).astype(int)
    steps = [
        a + np.arange(n)[:, None] / n * s for a, s, n in zip(vertices, sides, counts, strict=True)
    ]
    return np.concatenate(steps)
