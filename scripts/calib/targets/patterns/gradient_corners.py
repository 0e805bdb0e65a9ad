"""Corners where the edges meet: every gradient is perpendicular to its place about the corner."""

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

GRADIENT_SMOOTHING_PX = 1.0  # of the Gaussian whose derivatives are the gradients
MAX_CORNER_ROUNDS = 20
CORNER_STEP_TOLERANCE_PX = 1e-4


def refine_gradient_corners(
    grey: np.ndarray, uv: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return sub-pixel corners (n, 2) near pixels uv (n, 2), and which have converged (n,).

    grey: (h, w); uv: good to about a pixel; radius: px, of the disc about a corner that is used.
    Förstner and Gülch (1987): minimises Σ (gᵀ(p - corner))² over the disc, which follows the
    corner, with the gradients g of the image read between pixels by cubic splines. Strong gradients
    weigh most, so the steepest part of an edge counts. A corner that moves by more than the radius
    has not converged.
    """
    grey = grey.astype(float)
    gradient_splines = [
        spline_filter(gaussian_filter(grey, GRADIENT_SMOOTHING_PX, order=o))
        for o in ((0, 1), (1, 0))
    ]
    offsets = _disc_offsets(radius)
    corners, moved = uv.astype(float).copy(), np.full(len(uv), np.inf)
    for _ in range(MAX_CORNER_ROUNDS):
        points = corners[:, None] + offsets
        gx, gy = (_sample_splines(f, points) for f in gradient_splines)
        step = np.clip(_gradient_intersection(gx, gy, offsets), -1, 1)
        corners += step
        moved = np.abs(step).max(1)
        if (moved < CORNER_STEP_TOLERANCE_PX).all():
            break
    is_near = np.linalg.norm(corners - uv, axis=1) < radius
    return corners, (moved < 10 * CORNER_STEP_TOLERANCE_PX) & is_near


def _disc_offsets(radius: float) -> np.ndarray:
    """Return the whole pixels (k, 2) within a radius, px, of (0, 0)."""
    steps = np.arange(-int(radius), int(radius) + 1)
    grid = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2).astype(float)
    return grid[np.linalg.norm(grid, axis=1) <= radius]


def _sample_splines(splines: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the values (n, k) of filtered splines (h, w) at points (n, k, 2), px."""
    rows_columns = [points[..., 1], points[..., 0]]
    return map_coordinates(splines, rows_columns, order=3, prefilter=False, mode="nearest")


def _gradient_intersection(gx: np.ndarray, gy: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Return the least-squares points (n, 2) of gradients (n, k) at offsets (k, 2).

    Infinite where the image is flat.
    """
    xx, xy, yy = (gx * gx).sum(1), (gx * gy).sum(1), (gy * gy).sum(1)
    along = gx * offsets[:, 0] + gy * offsets[:, 1]
    bx, by = (gx * along).sum(1), (gy * along).sum(1)
    determinant = xx * yy - xy * xy
    is_flat = determinant < 1e-6 * (xx + yy) ** 2 + 1e-300
    safe = np.where(is_flat, 1.0, determinant)
    step = np.column_stack([yy * bx - xy * by, xx * by - xy * bx]) / safe[:, None]
    return np.where(is_flat[:, None], np.inf, step)
