"""Which crossings of a checkerboard an image shows: a detected grid, checked, grown and trimmed.

At a crossing opposite quadrants are alike and neighbours differ, alternating from one crossing to
the next. A plain border, a T of squares that end there, or what lies beyond has no such quadrants.
"""

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from calib.targets.patterns.edge_model import CornerFit
from calib.targets.patterns.image_region import (
    MAX_PLANE_MISFIT_SHARE,
    GridPlane,
    ImageRegion,
    make_grid_cells,
)

QUADRANT_OFFSET_SHARES = (0.12, 0.24, 0.36)  # of the way to the next corners; where levels are read
MIN_SADDLE_TO_STEP = 1.5  # of a crossing's saddle over its steps; a T has them alike
MIN_SADDLE_TO_MEDIAN = 0.3  # of the grid's median saddle
KEEP_LINE_SHARE = 0.3  # of crossings on a line that is kept
ADD_LINE_SHARE = 0.45  # of crossings on a line that is added
MAX_GROW_ROUNDS = 12
MIN_GRID_LINES = 3
N_LINES_BEYOND = 2  # lines beyond the grid that are checked, as the next one may be hidden

RefineCorners = Callable[[ImageRegion, np.ndarray, np.ndarray, np.ndarray], CornerFit]


class VerifiedGrid(NamedTuple):
    """Pixels (rows, columns, 2) of a grid, and the sign of the saddle of its first crossing."""

    uv: np.ndarray
    first_sign: float


def measure_saddles(
    grey: np.ndarray, uv: np.ndarray, along: np.ndarray, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the saddle (n,) and the larger step (n,), grey levels, about pixels uv (n, 2).

    grey: (h, w) uint8; along, across: (n, 2) vectors to the next corners, px. The saddle is
    positive where light lies ahead in both directions. NaN where a quadrant leaves the image.
    """
    a, b = np.meshgrid(QUADRANT_OFFSET_SHARES, QUADRANT_OFFSET_SHARES)
    signs = np.array([(i, j) for i in (1, -1) for j in (1, -1)])
    steps = signs[:, None, :] * np.stack([a.ravel(), b.ravel()], -1)
    sides = np.stack([along, across], 1)
    samples = uv[:, None, None] + steps @ sides[:, None]
    h, w = grey.shape
    is_inside = ((samples >= 0) & (samples <= [w - 1, h - 1])).all((-1, -2, -3))
    points = np.where(is_inside[:, None, None, None], samples, 0).astype(np.float32)
    points = points.reshape(len(uv), -1, 2)
    levels = cv2.remap(grey, points[..., 0], points[..., 1], cv2.INTER_LINEAR)
    level = np.median(levels.reshape(len(uv), 4, -1).astype(float), -1)
    saddle, *step = (level @ np.column_stack([signs.prod(1), signs]) / 4).T
    saddle, larger_step = np.stack([saddle, np.abs(step).max(0)])
    saddle[~is_inside] = larger_step[~is_inside] = np.nan
    return saddle, larger_step


def find_alternating_crossings(plane: GridPlane, cells: np.ndarray) -> tuple[np.ndarray, float]:
    """Return which cells (rows, columns, 2) are crossings that alternate, and the sign of the
    saddle of cell (0, 0). The outer two lines on every side are beyond the grid."""
    rows, columns = cells.shape[:2]
    flat = cells.reshape(-1, 2)
    uv_and_sides = [plane.project_cells(flat), *plane.cell_sides(flat)]
    is_known = np.isfinite(np.concatenate(uv_and_sides, 1)).all(1)
    saddle, step = np.full((2, rows * columns), np.nan)
    saddle[is_known], step[is_known] = measure_saddles(
        plane.region.grey, *(a[is_known] for a in uv_and_sides)
    )
    saddle = ((-1.0) ** flat.sum(1) * saddle).reshape(rows, columns)
    inside = saddle[N_LINES_BEYOND:-N_LINES_BEYOND, N_LINES_BEYOND:-N_LINES_BEYOND]
    middle = np.nanmedian(inside) if np.isfinite(inside).any() else 0.0
    is_dominant = np.abs(saddle) > MIN_SADDLE_TO_STEP * step.reshape(rows, columns)
    sign = np.sign(middle)
    return (saddle * sign > MIN_SADDLE_TO_MEDIAN * abs(middle)) & is_dominant, sign


def grow_and_trim_grid(
    region: ImageRegion, uv: np.ndarray, refine: RefineCorners
) -> VerifiedGrid | None:
    """Add lines of crossings to a grid and remove lines that are none, until neither is left.

    uv: seeds (rows, columns, 2), px. refine(region, uv, along, across) improves the pixels of a
    grid that has grown. Returns None if it is no grid.
    """
    for _ in range(MAX_GROW_ROUNDS):
        rows, columns = uv.shape[:2]
        cells = make_grid_cells(columns, rows)
        plane = GridPlane.fit_cells(region, cells.reshape(-1, 2), uv.reshape(-1, 2))
        if plane is None or not _is_on_plane(plane, cells, uv):
            return None
        crossings, sign = find_alternating_crossings(
            plane, make_grid_cells(columns, rows, N_LINES_BEYOND)
        )
        first, last = np.array([_count_line_changes(g) for g in (crossings.T, crossings)]).T
        if not first.any() and not last.any():
            return VerifiedGrid(uv, sign)
        low, high = -first, np.array([columns, rows]) + last
        if (high - low < MIN_GRID_LINES).any():
            return None
        new_cells = make_grid_cells(*(high - low)) + low
        uv = _resample_grid(plane, uv, new_cells)
        if np.isnan(uv).any():
            return None
        if (first > 0).any() or (last > 0).any():
            fit = refine(region, uv.reshape(-1, 2), *plane.cell_sides(new_cells.reshape(-1, 2)))
            uv = np.where(fit.is_valid[:, None], fit.uv, uv.reshape(-1, 2)).reshape(uv.shape)
    return None


def _is_on_plane(plane: GridPlane, cells: np.ndarray, uv: np.ndarray) -> bool:
    """Whether most pixels uv (rows, columns, 2) lie where the plane has their cells."""
    distance = np.linalg.norm(plane.project_cells(cells) - uv, axis=-1)
    spacing = np.linalg.norm(np.diff(uv, axis=1), axis=-1).min()
    return bool(np.median(distance) < MAX_PLANE_MISFIT_SHARE * spacing)


def _count_line_changes(crossings: np.ndarray) -> list[int]:
    """Return by how many lines, -1 to 2, a grid grows at its first and at its last line.

    crossings: (lines, nodes), of which the outer two on every side are beyond the grid.
    """
    share = crossings[:, N_LINES_BEYOND:-N_LINES_BEYOND].mean(1)
    changes = []
    for second_beyond, first_beyond, outermost in (share[:3], share[:-4:-1]):
        added = 1 if first_beyond > ADD_LINE_SHARE else 2 * (second_beyond > ADD_LINE_SHARE)
        changes.append(-1 if outermost < KEEP_LINE_SHARE else int(added))
    return changes


def _resample_grid(plane: GridPlane, uv: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the pixels (rows, columns, 2) of cells: seeds if there are, else the plane's."""
    out = plane.project_cells(cells)
    rows, columns = uv.shape[:2]
    has_seed = ((cells >= 0) & (cells < [columns, rows])).all(-1)
    i, j = cells[has_seed].T
    out[has_seed] = uv[j, i]
    return out
