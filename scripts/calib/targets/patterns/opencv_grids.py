"""Grids of crossings that OpenCV finds in an image: candidates, from the quick to the thorough."""

from collections.abc import Iterator

import cv2
import numpy as np

SQUARE_DETECTOR_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
SECTOR_DETECTOR_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
MIN_GRID_CORNERS = (3, 3)  # smallest part of a grid to grow from where the rest is hidden
MAX_ENLARGED_PX = 500  # wider regions are not enlarged
EQUAL_MEAN, EQUAL_CONTRAST = 128, 60  # grey levels of an image with equalized contrast


def find_grid_fast(grey: np.ndarray, columns: int, rows: int) -> np.ndarray | None:
    """Return the pixels (rows, columns, 2) of a whole grid of dark squares on a light border.

    Returns None early, and too early if squares are small or flat; see find_grid_by_squares.
    """
    return find_grid_by_squares(
        grey, columns, rows, SQUARE_DETECTOR_FLAGS | cv2.CALIB_CB_FAST_CHECK
    )


def find_grid_by_squares(
    grey: np.ndarray, columns: int, rows: int, flags: int = SQUARE_DETECTOR_FLAGS
) -> np.ndarray | None:
    """Return as find_grid_fast, without giving up early: 2 s for a large image without a grid."""
    is_found, corners = cv2.findChessboardCorners(grey, (columns, rows), flags=flags)
    return corners.reshape(rows, columns, 2).astype(float) if is_found else None


def iterate_grid_candidates(
    grey: np.ndarray, columns: int, rows: int
) -> Iterator[np.ndarray | None]:
    """Yield the grids (r, c, 2), px, of every detector, the quickest first, or None.

    Each of them may be wrong, and some are a part of the grid or hold more.
    """
    yield find_grid_fast(grey, columns, rows)
    for image in (grey, equalize_contrast(grey)):
        yield find_grid_by_sectors(image)
    yield find_grid_by_squares(grey, columns, rows)
    if max(grey.shape) <= MAX_ENLARGED_PX:
        enlarged = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
        grid = find_grid_by_squares(enlarged, columns, rows)
        yield None if grid is None else (grid - 0.5) / 2


def find_grid_by_sectors(
    grey: np.ndarray, min_columns: int = MIN_GRID_CORNERS[0], min_rows: int = MIN_GRID_CORNERS[1]
) -> np.ndarray | None:
    """Return the largest grid (r, c, 2) of at least that size, or None.

    The detector of Duda and Frese (2018) needs no border; if corners are covered it finds a part.
    """
    is_found, corners, cells = cv2.findChessboardCornersSBWithMeta(
        grey, (min_columns, min_rows), SECTOR_DETECTOR_FLAGS
    )
    return corners.reshape(*cells.shape[:2], 2).astype(float) if is_found else None


def equalize_contrast(grey: np.ndarray) -> np.ndarray:
    """Return the image (h, w) uint8 with the same local mean and local contrast everywhere."""
    width = max(15, min(grey.shape) // 6) | 1
    mean = cv2.blur(grey, (width, width)).astype(float)
    difference = grey - mean
    spread = np.sqrt(cv2.blur(difference * difference, (width, width))) + 4.0
    return np.clip(EQUAL_MEAN + EQUAL_CONTRAST * difference / spread, 0, 255).astype(np.uint8)
