"""A ChArUco board: a checkerboard whose white squares carry markers, so that any part of it tells
which part it is. Its inner corners count in rows along +x, rows along +y, as a checkerboard's."""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from calib.io.status import OK, Status, failed
from calib.targets.patterns import asymmetric_edges, edge_model
from calib.targets.patterns.checkerboard import ROUNDING, uncovered
from calib.targets.patterns.detected_corners import Corners
from calib.targets.patterns.image_region import FEWEST, Plane, Region, lattice


@dataclass(frozen=True)
class Charuco:
    """squares (along x, along y) of side `square` m, markers of side `marker` m of an OpenCV
    dictionary, the board's middle at the origin; legacy: as OpenCV drew it before 4.6."""

    squares: tuple
    square: float
    marker: float
    dictionary: str
    legacy: bool = False

    name, share = "ChArUco board", 0.3

    @classmethod
    def from_config(cls, config):
        sizes = tuple(config["squares"]), config["square_m"], config["marker_m"]
        return cls(*sizes, config["dictionary"], config["legacy"])

    @property
    def expected(self):
        return f"{FEWEST} or more of {(self.squares[0] - 1) * (self.squares[1] - 1)} inner corners"

    @property
    def outline(self):
        """(4, 2), m, of the printed squares."""
        half = self.square * np.array(self.squares) / 2
        return half * [[1, 1], [-1, 1], [-1, -1], [1, -1]]

    @property
    def _cells(self):
        return lattice(self.squares[0] - 1, self.squares[1] - 1).reshape(-1, 2)

    def corners(self):
        """(n, 3), m, target frame; x runs fastest."""
        at = self.square * (self._cells + 1 - np.array(self.squares) / 2)
        return np.column_stack([at, np.zeros(len(at))])

    def scaled(self, factor):
        return replace(self, square=self.square * factor, marker=self.marker * factor)

    def labellings(self):
        """(1, n): the markers leave nothing open."""
        return np.arange(len(self._cells))[None]

    @cached_property
    def _detector(self):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard(self.squares, self.square, self.marker, dictionary)
        board.setLegacyPattern(self.legacy)
        return cv2.aruco.CharucoDetector(board)

    def _read(self, grey):
        """Indices (m,) into corners() of those seen, and their pixels (m, 2), roughly."""
        uv, ids, _, _ = self._detector.detectBoard(grey)
        if ids is None:
            return np.zeros(0, int), np.zeros((0, 2))
        columns, rows = np.array(self.squares) - 1
        # OpenCV's rows run down the board.
        row, column = np.divmod(ids.reshape(-1), columns)
        return (rows - 1 - row) * columns + column, uv.reshape(-1, 2).astype(float)

    def _mirrored(self, grey):
        """Whether a grey image (h, w) uint8 shows the board as a mirror would."""
        return len(self._read(np.ascontiguousarray(grey[:, ::-1]))[0]) >= FEWEST

    def detect(self, grey):
        """All corners (n, 2) of a grey image (h, w) uint8 in order, or None if some are hidden."""
        index, uv = self._read(grey)
        return uv[np.argsort(index)] if len(index) == len(self._cells) else None

    def locate(self, grey, camera, offset):
        """(Corners, Status) of what a grey region (h, w) uint8 shows whose first pixel is at offset
        (2,) of the camera's image; no Corners, and why, where that is too little."""
        region = Region(grey, camera, np.asarray(offset, float))
        index, uv = self._read(grey)
        cells = self._cells[index]
        if (
            len(index) < FEWEST
            and len(self._read(np.ascontiguousarray(grey[:, ::-1]))[0]) >= FEWEST
        ):
            return None, failed(
                f"the {self.name} is seen mirrored",
                "markers that read backwards",
                self.expected,
                "Print it anew as it is, not mirrored; or switch off the camera's mirror image.",
            )
        flat = len(index) < FEWEST or min(map(len, map(np.unique, cells.T))) < 2
        plane = None if flat else Plane.through(region, cells, uv)
        if plane is None:
            found = f"{len(index)} corners"
            return None, failed(f"no {self.name} in the region", found, self.expected)
        sides = plane.sides(cells)
        fit = asymmetric_edges.corrected(region, edge_model.refine(region, uv, *sides), *sides)
        good = uncovered(region, cells, fit)
        if good.sum() < FEWEST:
            found = f"{int(good.sum())} of {len(good)} corners that are clear"
            return None, failed(f"no {self.name} in the region", found, self.expected)
        noise = max(float(np.median(fit.rms[good])), ROUNDING)
        missing = len(self._cells) - int(good.sum())
        status = (
            Status(reason=f"{missing} of {len(self._cells)} corners not seen") if missing else OK
        )
        found = fit.uv[good] + region.offset
        return Corners(index[good], found, noise**2 * fit.covariance[good]), status
