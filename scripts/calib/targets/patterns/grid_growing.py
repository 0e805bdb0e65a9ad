"""Which crossings of a checkerboard an image shows: a detected grid, checked, grown and trimmed.

At a crossing opposite quadrants are alike and neighbours differ, by turns from one crossing to the
next. A plain border, a T of squares that end there, or what lies beyond has no such quadrants.
"""

import cv2
import numpy as np

from calib.targets.patterns.image_region import MAX_PLANE_MISFIT_SHARE, GridPlane, make_grid_cells

QUADRANT_OFFSET_SHARES = (
    0.12,
    0.24,
    0.36,
)  # where quadrants are read, of the way to the next corners
MIN_SADDLE_TO_STEP = 1.5  # of a crossing's saddle over its steps; a T has them alike
MIN_SADDLE_TO_MEDIAN = 0.3  # of the grid's median saddle
KEEP_LINE_SHARE, ADD_LINE_SHARE = (
    0.3,
    0.45,
)  # share of crossings on a line that stays, and of one that is added
MAX_GROW_ROUNDS = 12


def measure_saddles(grey, uv, along, across):
    """Saddle (n,), positive where light lies ahead in both directions, and larger step (n,), grey
    levels, about pixels uv (n, 2); NaN where a quadrant leaves the image (h, w)."""
    a, b = np.meshgrid(QUADRANT_OFFSET_SHARES, QUADRANT_OFFSET_SHARES)
    signs = np.array([(i, j) for i in (1, -1) for j in (1, -1)])
    steps = signs[:, None, :] * np.stack([a.ravel(), b.ravel()], -1)
    sides = np.stack([along, across], 1)
    at = uv[:, None, None] + steps @ sides[:, None]
    h, w = grey.shape
    inside = ((at >= 0) & (at <= [w - 1, h - 1])).all((-1, -2, -3))
    points = np.where(inside[:, None, None, None], at, 0).astype(np.float32)
    read = cv2.remap(grey, points.reshape(len(uv), -1, 2), None, cv2.INTER_LINEAR)
    level = np.median(read.reshape(len(uv), 4, -1).astype(float), -1)
    saddle, *step = (level @ np.column_stack([signs.prod(1), signs]) / 4).T
    out = np.stack([saddle, np.abs(step).max(0)])
    out[:, ~inside] = np.nan
    return out


def find_alternating_crossings(plane, cells):
    """Which cells (rows, columns, 2) are crossings by turns, and the sign of cell (0, 0); the outer
    two lines on every side are beyond the grid."""
    rows, columns = cells.shape[:2]
    flat = cells.reshape(-1, 2)
    where = [plane.project_cells(flat), *plane.cell_sides(flat)]
    known = np.isfinite(np.concatenate(where, 1)).all(1)
    saddle, step = np.full((2, rows * columns), np.nan)
    saddle[known], step[known] = measure_saddles(plane.region.grey, *(a[known] for a in where))
    turned = ((-1.0) ** flat.sum(1) * saddle).reshape(rows, columns)
    inside = turned[2:-2, 2:-2]
    middle = np.nanmedian(inside) if np.isfinite(inside).any() else 0.0
    dominant = np.abs(turned) > MIN_SADDLE_TO_STEP * step.reshape(rows, columns)
    return (turned * np.sign(middle) > MIN_SADDLE_TO_MEDIAN * abs(middle)) & dominant, np.sign(
        middle
    )


def grow_and_trim_grid(region, uv, refine):
    """A grid of seeds (rows, columns, 2), grown by lines that are crossings and trimmed of those
    that are not, until neither is left: (grid, sign of its first crossing); None if it is no grid.

    refine(region, uv, along, across) betters the pixels of a grid that has grown.
    """
    for _ in range(MAX_GROW_ROUNDS):
        rows, columns = uv.shape[:2]
        cells = make_grid_cells(columns, rows)
        plane = GridPlane.fit_cells(region, cells.reshape(-1, 2), uv.reshape(-1, 2))
        if plane is None or not _is_on_plane(plane, cells, uv):
            return None
        good, sign = find_alternating_crossings(plane, make_grid_cells(columns, rows, 2))
        first, last = np.array([_count_line_changes(g) for g in (good.T, good)]).T
        if not first.any() and not last.any():
            return uv, sign
        low, high = -first, np.array([columns, rows]) + last
        if (high - low < 3).any():
            return None
        wider = make_grid_cells(*(high - low)) + low
        uv = _resample_grid(plane, uv, wider)
        if np.isnan(uv).any():
            return None
        if (first > 0).any() or (last > 0).any():
            flat = wider.reshape(-1, 2)
            fit = refine(region, uv.reshape(-1, 2), *plane.cell_sides(flat))
            uv = np.where(fit.is_valid[:, None], fit.uv, uv.reshape(-1, 2)).reshape(uv.shape)
    return None


def _is_on_plane(plane, cells, uv):
    off = np.linalg.norm(plane.project_cells(cells) - uv, axis=-1)
    spacing = np.linalg.norm(np.diff(uv, axis=1), axis=-1).min()
    return np.median(off) < MAX_PLANE_MISFIT_SHARE * spacing


def _count_line_changes(good):
    """By how many lines, -1 to 2, a grid grows at the first and last of the lines of good (lines,
    nodes), of which the outer two on every side are beyond it: a line may be hidden."""
    share = good[:, 2:-2].mean(1)
    changes = []
    for farther, beyond, own in (share[:3], share[:-4:-1]):
        grown = 1 if beyond > ADD_LINE_SHARE else 2 * (farther > ADD_LINE_SHARE)
        changes.append(-1 if own < KEEP_LINE_SHARE else int(grown))
    return changes


def _resample_grid(plane, uv, cells):
    """Pixels (rows, columns, 2) of those cells: the seeds that there are, else by the plane."""
    out = plane.project_cells(cells)
    rows, columns = uv.shape[:2]
    had = ((cells >= 0) & (cells < [columns, rows])).all(-1)
    i, j = cells[had].T
    out[had] = uv[j, i]
    return out
