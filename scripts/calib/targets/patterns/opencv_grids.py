"""Grids of crossings that OpenCV finds in an image: candidates, from the quick to the thorough."""

import cv2
import numpy as np

SQUARE_DETECTOR_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
SECTOR_DETECTOR_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
MIN_GRID_CORNERS = (3, 3)  # smallest part of a grid to grow from where the rest is hidden
MAX_ENLARGED_PX = 500  # wider regions are not enlarged


def find_grid_fast(grey, columns, rows):
    """Pixels (rows, columns, 2) of a whole grid of dark squares on a light border, or None.

    Gives up early, and too early where squares are small or flat; see by_squares.
    """
    return find_grid_by_squares(
        grey, columns, rows, SQUARE_DETECTOR_FLAGS | cv2.CALIB_CB_FAST_CHECK
    )


def find_grid_by_squares(grey, columns, rows, flags=SQUARE_DETECTOR_FLAGS):
    """The same, at any pains: two seconds for a large image that holds none."""
    found, corners = cv2.findChessboardCorners(grey, (columns, rows), flags=flags)
    return corners.reshape(rows, columns, 2).astype(float) if found else None


def iterate_grid_candidates(grey, columns, rows):
    """Grids (r, c, 2), px, that some way of looking finds, the quickest first; each of them may be
    wrong, and some are a part or hold more."""
    yield find_grid_fast(grey, columns, rows)
    for image in (grey, equalize_contrast(grey)):
        yield find_grid_by_sectors(image)
    yield find_grid_by_squares(grey, columns, rows)
    if max(grey.shape) <= MAX_ENLARGED_PX:
        twice = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
        found = find_grid_by_squares(twice, columns, rows)
        yield None if found is None else (found - 0.5) / 2


def find_grid_by_sectors(grey, columns=MIN_GRID_CORNERS[0], rows=MIN_GRID_CORNERS[1]):
    """The largest grid (r, c, 2), no smaller than that, that the detector of Duda and Frese (2018)
    finds, or None: it needs no border, and of a grid with covered corners it finds a part."""
    found, corners, cells = cv2.findChessboardCornersSBWithMeta(
        grey, (columns, rows), SECTOR_DETECTOR_FLAGS
    )
    return corners.reshape(*cells.shape[:2], 2).astype(float) if found else None


def equalize_contrast(grey):
    """The image (h, w) uint8 with its local mean at mid-grey and its local contrast alike."""
    width = max(15, min(grey.shape) // 6) | 1
    mean = cv2.blur(grey, (width, width)).astype(float)
    away = grey - mean
    spread = np.sqrt(cv2.blur(away * away, (width, width))) + 4.0
    return np.clip(128 + 60 * away / spread, 0, 255).astype(np.uint8)
