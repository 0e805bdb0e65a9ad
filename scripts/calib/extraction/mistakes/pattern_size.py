"""A pattern with another number of corners or squares, or another dictionary of markers."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import cv2
import numpy as np

from calib.extraction.mistakes.pattern_layout import describe_charuco, describe_checkerboard
from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.targets.patterns.charuco import Charuco
from calib.targets.patterns.checkerboard import Checkerboard
from calib.targets.patterns.opencv_grids import find_grid_by_sectors

DICTIONARIES = (
    "DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_36H11",
)  # fmt: skip
N_IMAGES_COUNTED = 4
MAX_SQUARE_DIFFERENCE = 3  # from the stated number, along x and y
MIN_MARKERS = 4


def correct_pattern_size(stated: StatedSetup) -> Iterator[ConfigCorrection]:
    """Yield the setups with another number of squares or dictionary (see Mistake)."""
    for name, target in sorted(stated.targets.items()):
        if isinstance(target.pattern, Checkerboard):
            yield from _correct_counts(stated, name, target.pattern)
        elif isinstance(target.pattern, Charuco):
            for pattern in _list_charucos(stated, target.pattern):
                yield describe_charuco(stated, name, target.pattern, pattern)


def _correct_counts(
    stated: StatedSetup, name: str, pattern: Checkerboard
) -> Iterator[ConfigCorrection]:
    """Yield the number of inner corners that most images show, both ways, about the middle."""
    grids = [find_grid_by_sectors(image) for image in stated.images[:N_IMAGES_COUNTED]]
    counts = Counter(tuple(sorted(g.shape[:2], reverse=True)) for g in grids if g is not None)
    if not counts:
        return
    most = counts.most_common(1)[0][0]
    if most == tuple(sorted((pattern.n_columns, pattern.n_rows), reverse=True)):
        return
    middle = pattern.corners()[:, :2].mean(0)
    for columns, rows in (most, most[::-1]):
        other = replace(pattern, n_columns=columns, n_rows=rows)
        centred = middle + pattern.first_corner - other.corners()[:, :2].mean(0)
        for first in (pattern.first_corner, tuple(np.round(centred, 4).tolist())):
            found = replace(other, first_corner=first)
            yield describe_checkerboard(stated, name, pattern, found)


def _list_charucos(stated: StatedSetup, pattern: Charuco) -> list[Charuco]:
    """Return the boards that show most corners in the first images: other squares or markers."""
    images = stated.images[:N_IMAGES_COUNTED]
    dictionary = _find_dictionary(images, pattern.dictionary)
    span = range(-MAX_SQUARE_DIFFERENCE, MAX_SQUARE_DIFFERENCE + 1)
    x, y = pattern.n_squares
    sizes = [(x + i, y + j) for i, j in product(span, span) if min(x + i, y + j) >= 3]
    boards = [replace(pattern, dictionary=dictionary, n_squares=size) for size in sizes]
    counts = [sum(board.detect_corners_fast(i) is not None for i in images) for board in boards]
    best = max(counts, default=0)
    return [b for b, n in zip(boards, counts, strict=True) if best and n == best and b != pattern]


def _find_dictionary(images: tuple[np.ndarray, ...], stated: str) -> str:
    """Return the dictionary whose markers the images show, the stated one if it does."""

    def count_markers(name: str) -> int:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        detector = cv2.aruco.ArucoDetector(dictionary)
        found = [detector.detectMarkers(image)[1] for image in images]
        return sum(len(ids) for ids in found if ids is not None)

    if count_markers(stated) >= MIN_MARKERS:
        return stated
    counts = {name: count_markers(name) for name in DICTIONARIES}
    best = max(counts, key=lambda name: counts[name])
    return best if counts[best] >= MIN_MARKERS else stated
