"""A ChArUco board: a checkerboard whose white squares carry markers, so that any part of it tells
which part it is. Its inner corners count in rows along +x, rows along +y, as a checkerboard's."""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from calib.io.status import OK, Status, failure_status
from calib.targets.patterns.asymmetric_edges import fix_asymmetric_edges
from calib.targets.patterns.checkerboard import GREY_ROUNDING_RMS, is_clear_corner
from calib.targets.patterns.detected_corners import DetectedCorners
from calib.targets.patterns.edge_model import fit_corner_edges
from calib.targets.patterns.image_region import (
    MIN_PLANE_CELLS,
    GridPlane,
    ImageRegion,
    make_grid_cells,
)


@dataclass(frozen=True)
class Charuco:
    """squares (along x, along y) of side `square` m, markers of side `marker` m of an OpenCV
    dictionary, the board's middle at the origin; legacy: as OpenCV drew it before 4.6."""

    n_squares: tuple
    square_m: float
    marker_m: float
    dictionary: str
    is_legacy: bool = False

    name, min_visible_share = "ChArUco board", 0.3

    @classmethod
    def from_config(cls, config):
        sizes = tuple(config["squares"]), config["square_m"], config["marker_m"]
        return cls(*sizes, config["dictionary"], config["legacy"])

    @property
    def expected_description(self):
        return f"{MIN_PLANE_CELLS} or more of {(self.n_squares[0] - 1) * (self.n_squares[1] - 1)} inner corners"

    @property
    def outline(self):
        """(4, 2), m, of the printed squares."""
        half = self.square_m * np.array(self.n_squares) / 2
        return half * [[1, 1], [-1, 1], [-1, -1], [1, -1]]

    @property
    def _cells(self):
        return make_grid_cells(self.n_squares[0] - 1, self.n_squares[1] - 1).reshape(-1, 2)

    def corners(self):
        """(n, 3), m, target frame; x runs fastest."""
        at = self.square_m * (self._cells + 1 - np.array(self.n_squares) / 2)
        return np.column_stack([at, np.zeros(len(at))])

    def with_scale(self, factor):
        return replace(self, square_m=self.square_m * factor, marker_m=self.marker_m * factor)

    def corner_orders(self):
        """(1, n): the markers leave nothing open."""
        return np.arange(len(self._cells))[None]

    @cached_property
    def _detector(self):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard(self.n_squares, self.square_m, self.marker_m, dictionary)
        board.setLegacyPattern(self.is_legacy)
        return cv2.aruco.CharucoDetector(board)

    def _detect_corners(self, grey):
        """Indices (m,) into corners() of those seen, and their pixels (m, 2), roughly."""
        uv, ids, _, _ = self._detector.detectBoard(grey)
        if ids is None:
            return np.zeros(0, int), np.zeros((0, 2))
        columns, rows = np.array(self.n_squares) - 1
        # OpenCV's rows run down the board.
        row, column = np.divmod(ids.reshape(-1), columns)
        return (rows - 1 - row) * columns + column, uv.reshape(-1, 2).astype(float)

    def _is_mirrored(self, grey):
        """Whether a grey image (h, w) uint8 shows the board as a mirror would."""
        return len(self._detect_corners(np.ascontiguousarray(grey[:, ::-1]))[0]) >= MIN_PLANE_CELLS

    def detect_corners_fast(self, grey):
        """All corners (n, 2) of a grey image (h, w) uint8 in order, or None if some are hidden."""
        index, uv = self._detect_corners(grey)
        return uv[np.argsort(index)] if len(index) == len(self._cells) else None

    def locate_corners(self, grey, camera, offset):
        """(Corners, Status) of what a grey region (h, w) uint8 shows whose first pixel is at offset
        (2,) of the camera's image; no Corners, and why, where that is too little."""
        region = ImageRegion(grey, camera, np.asarray(offset, float))
        index, uv = self._detect_corners(grey)
        cells = self._cells[index]
        if (
            len(index) < MIN_PLANE_CELLS
            and len(self._detect_corners(np.ascontiguousarray(grey[:, ::-1]))[0]) >= MIN_PLANE_CELLS
        ):
            return None, failure_status(
                f"the {self.name} is seen mirrored",
                "markers that read backwards",
                self.expected_description,
                "Print it anew as it is, not mirrored; or switch off the camera's mirror image.",
            )
        flat = len(index) < MIN_PLANE_CELLS or min(map(len, map(np.unique, cells.T))) < 2
        plane = None if flat else GridPlane.fit_cells(region, cells, uv)
        if plane is None:
            found = f"{len(index)} corners"
            return None, failure_status(
                f"no {self.name} in the region", found, self.expected_description
            )
        sides = plane.cell_sides(cells)
        fit = fix_asymmetric_edges(region, fit_corner_edges(region, uv, *sides), *sides)
        good = is_clear_corner(region, cells, fit)
        if good.sum() < MIN_PLANE_CELLS:
            found = f"{int(good.sum())} of {len(good)} corners that are clear"
            return None, failure_status(
                f"no {self.name} in the region", found, self.expected_description
            )
        noise = max(float(np.median(fit.rms[good])), GREY_ROUNDING_RMS)
        missing = len(self._cells) - int(good.sum())
        status = (
            Status(reason=f"{missing} of {len(self._cells)} corners not seen") if missing else OK
        )
        found = fit.uv[good] + region.offset
        return DetectedCorners(index[good], found, noise**2 * fit.covariance[good]), status
