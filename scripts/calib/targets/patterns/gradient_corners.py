"""Where the edges through a corner meet: every gradient around it is perpendicular to its place."""

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

GRADIENT_SMOOTHING_PX = 1.0  # of the Gaussian whose derivatives are the gradients
MAX_CORNER_ROUNDS = 20
CORNER_STEP_TOLERANCE_PX = 1e-4


def refine_gradient_corners(grey, uv, radius):
    """Sub-pixel corners (n, 2) from pixels uv (n, 2) good to about a pixel, and which settled (n,).

    Förstner and Gülch (1987): minimises Σ (gᵀ(p - corner))² over a disc of that radius, px, around
    the corner, with the gradients g of the image (h, w) read between pixels by cubic splines; the
    disc follows the corner. Strong gradients weigh most, so it is the steepest part of an edge that
    counts. A corner that wanders off by more than its radius has not settled.
    """
    grey = grey.astype(float)
    fields = [
        spline_filter(gaussian_filter(grey, GRADIENT_SMOOTHING_PX, order=o))
        for o in ((0, 1), (1, 0))
    ]
    offsets = _disc_offsets(radius)
    at, moved = uv.astype(float).copy(), np.full(len(uv), np.inf)
    for _ in range(MAX_CORNER_ROUNDS):
        points = at[:, None] + offsets
        gx, gy = (_sample_splines(f, points) for f in fields)
        step = np.clip(_gradient_intersection(gx, gy, offsets), -1, 1)
        at += step
        moved = np.abs(step).max(1)
        if (moved < CORNER_STEP_TOLERANCE_PX).all():
            break
    return at, (moved < 10 * CORNER_STEP_TOLERANCE_PX) & (np.linalg.norm(at - uv, axis=1) < radius)


def _disc_offsets(radius):
    steps = np.arange(-int(radius), int(radius) + 1)
    grid = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2).astype(float)
    return grid[np.linalg.norm(grid, axis=1) <= radius]


def _sample_splines(splines, points):
    where = [points[..., 1], points[..., 0]]
    return map_coordinates(splines, where, order=3, prefilter=False, mode="nearest")


def _gradient_intersection(gx, gy, offsets):
    """Least-squares points (n, 2) of gradients (n, k) at offsets (k, 2); infinite where flat."""
    xx, xy, yy = (gx * gx).sum(1), (gx * gy).sum(1), (gy * gy).sum(1)
    along = gx * offsets[:, 0] + gy * offsets[:, 1]
    bx, by = (gx * along).sum(1), (gy * along).sum(1)
    determinant = xx * yy - xy * xy
    flat = determinant < 1e-6 * (xx + yy) ** 2 + 1e-300
    safe = np.where(flat, 1.0, determinant)
    step = np.column_stack([yy * bx - xy * by, xx * by - xy * bx]) / safe[:, None]
    return np.where(flat[:, None], np.inf, step)
