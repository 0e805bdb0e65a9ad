"""A pattern with another number of corners or squares, or another dictionary of markers."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np

from calib.extraction.mistakes.pattern_layout import describe_charuco, describe_checkerboard
from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.io.status import Status, failure_status
from calib.targets.patterns.charuco import Charuco
from calib.targets.patterns.checkerboard import Checkerboard
from calib.targets.patterns.opencv_grids import find_grid_by_sectors

DICTIONARIES = (
    "DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16H5", "DICT_APRILTAG_25H9", "DICT_APRILTAG_36H10", "DICT_APRILTAG_36H11",
    "DICT_ARUCO_MIP_36H12",
)  # fmt: skip
N_IMAGES_COUNTED = 4
MAX_SQUARE_DIFFERENCE = 3  # from the stated number, along x and y
MAX_SQUARES = 30  # along x and y, of a board that the ids of its markers tell
MIN_MARKERS = 4
MIN_MARKER_RATIO = 1.5  # of another dictionary's markers in the images over the stated one's


class SeenMarkers(NamedTuple):
    """Markers of a dictionary in some images: all their ids (n,)."""

    dictionary: str
    ids: np.ndarray


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
    """Return the boards that show most corners in the first images: other squares or markers.

    With as many markers as their ids tell; if none of them, near the stated size.
    """
    images = stated.images[:N_IMAGES_COUNTED]
    seen = _find_markers(images, pattern.dictionary)
    span = range(-MAX_SQUARE_DIFFERENCE, MAX_SQUARE_DIFFERENCE + 1)
    x, y = pattern.n_squares
    near = {(x + i, y + j) for i, j in product(span, span) if min(x + i, y + j) >= 3}
    for sizes in (_list_sizes_with_markers(int(seen.ids.max(initial=0)) + 1), near):
        boards = [
            replace(pattern, dictionary=seen.dictionary, n_squares=size) for size in sorted(sizes)
        ]
        counts = [sum(board.detect_corners_fast(i) is not None for i in images) for board in boards]
        best = max(counts, default=0)
        if best:
            break
    return [b for b, n in zip(boards, counts, strict=True) if best and n == best and b != pattern]


def _list_sizes_with_markers(n_markers: int) -> set[tuple[int, int]]:
    """Return the numbers of squares (along x, along y) of the boards with so many markers."""
    counts = range(3, MAX_SQUARES + 1)
    return {(x, y) for x, y in product(counts, counts) if x * y // 2 == n_markers}


def _find_markers(images: tuple[np.ndarray, ...], stated: str) -> SeenMarkers:
    """Return the markers in some images: of the stated dictionary, unless another one has more."""
    own = _detect_markers(images, stated)
    best = max((_detect_markers(images, name) for name in DICTIONARIES), key=lambda m: len(m.ids))
    is_other = len(best.ids) >= max(MIN_MARKERS, MIN_MARKER_RATIO * len(own.ids))
    return best if is_other else own


def _detect_markers(images: tuple[np.ndarray, ...], name: str) -> SeenMarkers:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    detector = cv2.aruco.ArucoDetector(dictionary)
    found = [detector.detectMarkers(image)[1] for image in images]
    ids = [part.reshape(-1) for part in found if part is not None]
    return SeenMarkers(name, np.concatenate([np.zeros(0, int), *ids]))


def describe_other_markers(stated: StatedSetup) -> Status | None:
    """Return a status on markers in the images that no stated ChArUco board has, if there are any.

    For images that no board explains: it says which markers they show, and which are expected.
    """
    images = stated.images[:N_IMAGES_COUNTED]
    for name, target in sorted(stated.targets.items()):
        if not isinstance(target.pattern, Charuco):
            continue
        seen, n_ids = _find_markers(images, target.pattern.dictionary), target.pattern.n_markers
        if len(seen.ids) < MIN_MARKERS:
            continue
        last = int(seen.ids.max())
        if seen.dictionary != target.pattern.dictionary or last >= n_ids:
            return _other_markers_status(stated.sensor, name, target.pattern, seen)
    return None


def _other_markers_status(sensor: str, name: str, pattern: Charuco, seen: SeenMarkers) -> Status:
    last, squares = int(seen.ids.max()), list(pattern.n_squares)
    return failure_status(
        f"the images of {sensor} show markers that the ChArUco board of {name} does not have",
        f"{len(seen.ids)} markers of {seen.dictionary}, with ids up to {last}",
        f"markers of {pattern.dictionary} with ids 0 to {pattern.n_markers - 1}, of "
        f"squares {squares}",
        f"Set pattern.squares, pattern.dictionary and pattern.legacy of {name} to those of the "
        f"print. A board with {last + 1} markers has {2 * (last + 1)} or {2 * last + 3} squares.",
    )
