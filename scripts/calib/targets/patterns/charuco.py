"""A ChArUco board: a checkerboard whose white squares carry markers, so that any part of it shows
which part it is. Its inner corners count in rows along +x, rows along +y, as a checkerboard's."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from calib.geometry.units import MM_PER_M
from calib.io.status import OK, Status, failure_status
from calib.targets.patterns.asymmetric_edges import fix_asymmetric_edges
from calib.targets.patterns.checkerboard import is_clear_corner, select_detected_corners
from calib.targets.patterns.detected_corners import DetectedCorners
from calib.targets.patterns.edge_model import fit_corner_edges
from calib.targets.patterns.image_region import (
    MIN_PLANE_CELLS,
    CameraProjection,
    GridPlane,
    ImageRegion,
    make_grid_cells,
)

PRINT_PX_PER_SQUARE = 64  # of the print that tells how dark a point is


@dataclass(frozen=True)
class Charuco:
    """A board with its middle at the origin; see TargetPattern for its members.

    n_squares: along x and along y; square_m, marker_m: sides; dictionary: OpenCV's name;
    is_legacy: as OpenCV drew it before 4.6.
    """

    n_squares: tuple[int, ...]
    square_m: float
    marker_m: float
    dictionary: str
    is_legacy: bool = False

    name = "ChArUco board"
    min_visible_share = 0.3

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> "Charuco":
        """Make the pattern of a target's `pattern` block."""
        return cls(
            n_squares=tuple(config["squares"]),
            square_m=config["square_m"],
            marker_m=config["marker_m"],
            dictionary=config["dictionary"],
            is_legacy=config["legacy"],
        )

    @property
    def expected_description(self) -> str:
        return f"{MIN_PLANE_CELLS} or more of {len(self._cells)} inner corners"

    @property
    def n_markers(self) -> int:
        """Return the number of markers: one in every white square."""
        return self.n_squares[0] * self.n_squares[1] // 2

    @property
    def outline(self) -> np.ndarray:
        half = self.square_m * np.array(self.n_squares) / 2
        return half * [[1, 1], [-1, 1], [-1, -1], [1, -1]]

    @property
    def print_description(self) -> str:
        square_mm, marker_mm = (f"{MM_PER_M * m:g} mm" for m in (self.square_m, self.marker_m))
        return (
            f"ChArUco board, {self.n_squares[0]} × {self.n_squares[1]} squares of {square_mm} "
            f"along x × y, markers of {marker_mm}, {self.dictionary}"
        )

    def black_rectangles(self) -> np.ndarray:
        """See TargetPattern: black squares, and the black cells of markers, joined along x."""
        low = self.square_m * (
            make_grid_cells(*self.n_squares).reshape(-1, 2) - np.array(self.n_squares) / 2
        )
        margin = (self.square_m - self.marker_m) / 2
        is_black = self.darkness(low + margin / 2)[:, 0] > 0.5
        squares = np.stack([low, low + self.square_m], axis=1)[is_black]
        markers = [self._marker_rectangles(corner) for corner in low[~is_black] + margin]
        return np.concatenate([squares, *markers])

    def _marker_rectangles(self, corner: np.ndarray) -> np.ndarray:
        """Return the black runs (n, 2, 2) of the marker whose low corner (2,) is given."""
        n_cells = self._board.getDictionary().markerSize + 2  # with its border
        side = self.marker_m / n_cells
        centres = corner + side * (make_grid_cells(n_cells, n_cells) + 0.5)
        is_black = self.darkness(centres.reshape(-1, 2)).reshape(n_cells, n_cells) > 0.5
        out = []
        for row, line in enumerate(is_black):
            edges = np.flatnonzero(np.diff(np.pad(line.astype(int), 1)))
            for first, last in edges.reshape(-1, 2):
                out.append(corner + side * np.array([[first, row], [last, row + 1]]))
        return np.array(out)

    @property
    def _cells(self) -> np.ndarray:
        """Cells (n, 2) of all corners."""
        return make_grid_cells(self.n_squares[0] - 1, self.n_squares[1] - 1).reshape(-1, 2)

    def corners(self) -> np.ndarray:
        """Return all corners (n, 3); x runs fastest."""
        xy = self.square_m * (self._cells + 1 - np.array(self.n_squares) / 2)
        return np.column_stack([xy, np.zeros(len(xy))])

    def darkness(self, xy: np.ndarray) -> np.ndarray:
        size = self.square_m * np.array(self.n_squares)
        pixel = np.floor(PRINT_PX_PER_SQUARE * (xy + size / 2) / self.square_m).astype(int)
        n_columns, n_rows = PRINT_PX_PER_SQUARE * np.array(self.n_squares)
        column, row = pixel[:, 0], n_rows - 1 - pixel[:, 1]
        is_print = (column >= 0) & (column < n_columns) & (row >= 0) & (row < n_rows)
        dark = np.zeros((len(xy), 1))
        dark[is_print, 0] = 1 - self._print[row[is_print], column[is_print]] / 255
        return dark

    def with_scale(self, factor: float) -> "Charuco":
        return replace(self, square_m=self.square_m * factor, marker_m=self.marker_m * factor)

    def corner_orders(self) -> np.ndarray:
        """Return (1, n): the markers leave one way to number the corners."""
        return np.arange(len(self._cells))[None]

    @cached_property
    def _print(self) -> np.ndarray:
        """The board as it is printed, (h, w) uint8, rows down."""
        size = tuple(PRINT_PX_PER_SQUARE * n for n in self.n_squares)
        return self._board.generateImage(size, marginSize=0)

    @cached_property
    def _detector(self) -> cv2.aruco.CharucoDetector:
        return cv2.aruco.CharucoDetector(self._board)

    @cached_property
    def _board(self) -> cv2.aruco.CharucoBoard:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard(self.n_squares, self.square_m, self.marker_m, dictionary)
        board.setLegacyPattern(self.is_legacy)
        return board

    def _detect_corners(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return indices (m,) into corners() of visible corners, and rough pixels (m, 2)."""
        uv, ids, _, _ = self._detector.detectBoard(grey)
        if ids is None:
            return np.zeros(0, int), np.zeros((0, 2))
        columns, rows = np.array(self.n_squares) - 1
        # OpenCV's rows run down the board.
        row, column = np.divmod(ids.reshape(-1), columns)
        return (rows - 1 - row) * columns + column, uv.reshape(-1, 2).astype(float)

    def _is_mirrored(self, grey: np.ndarray) -> bool:
        """Whether a grey image (h, w) uint8 shows the board as a mirror would."""
        index, _ = self._detect_corners(np.ascontiguousarray(grey[:, ::-1]))
        return len(index) >= MIN_PLANE_CELLS

    def detect_corners_fast(self, grey: np.ndarray) -> np.ndarray | None:
        """Return the pixels (n, 2) of all corners in order, or None if some are hidden."""
        index, uv = self._detect_corners(grey)
        return uv[np.argsort(index)] if len(index) == len(self._cells) else None

    def locate_corners(
        self, grey: np.ndarray, camera: CameraProjection, offset: np.ndarray
    ) -> tuple[DetectedCorners | None, Status]:
        """Return the verified corners in an image region, or None and why there are too few."""
        index, uv = self._detect_corners(grey)
        if len(index) < MIN_PLANE_CELLS and self._is_mirrored(grey):
            return None, self._mirrored_status()
        region = ImageRegion(grey, camera, np.asarray(offset, float))
        corners, rejection = self._fit_corners(region, index, uv)
        if corners is None:
            return None, failure_status(
                f"no {self.name} in the region", rejection, self.expected_description
            )
        n, n_clear = len(self._cells), len(corners.corner_index)
        return corners, Status(
            reason=f"{n - n_clear} of {n} corners not seen"
        ) if n_clear < n else OK

    def _mirrored_status(self) -> Status:
        return failure_status(
            f"the {self.name} is seen mirrored",
            "markers that read backwards",
            self.expected_description,
            "Print it again without mirroring, or switch off the camera's mirror image.",
        )

    def _fit_corners(
        self, region: ImageRegion, index: np.ndarray, uv: np.ndarray
    ) -> tuple[DetectedCorners | None, str]:
        """Fit the corners of those indices (m,) from pixels (m, 2), or say what is wrong."""
        cells = self._cells[index]
        has_plane = len(index) >= MIN_PLANE_CELLS and min(map(len, map(np.unique, cells.T))) >= 2
        plane = GridPlane.fit_cells(region, cells, uv) if has_plane else None
        if plane is None:
            return None, f"{len(index)} corners"
        sides = plane.cell_sides(cells)
        fit = fix_asymmetric_edges(region, fit_corner_edges(region, uv, *sides), *sides)
        is_clear = is_clear_corner(region, cells, fit)
        if is_clear.sum() < MIN_PLANE_CELLS:
            return None, f"{int(is_clear.sum())} of {len(is_clear)} corners that are clear"
        return select_detected_corners(region, fit, is_clear, index), ""
