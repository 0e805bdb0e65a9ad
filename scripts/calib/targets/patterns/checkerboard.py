"""A printed checkerboard: inner corners in rows along +x, rows along +y, in the plane z = 0."""

from dataclasses import dataclass

import cv2
import numpy as np

from calib.targets.patterns import subpixel


@dataclass(frozen=True)
class Checkerboard:
    """columns × rows inner corners, `square` m apart, the first at `first` (x, y), m.

    first_square: colour of the square at the low-x, low-y end, black, white or None (not stated).
    """

    columns: int
    rows: int
    square: float
    first: tuple
    first_square: str | None = None

    name = "checkerboard"

    @classmethod
    def from_config(cls, config):
        columns, rows = config["inner_corners"]
        first = tuple(config["first_corner_m"])
        return cls(columns, rows, config["square_m"], first, config.get("first_square"))

    @property
    def expected(self):
        return f"{self.columns} × {self.rows} inner corners"

    def corners(self):
        """(columns·rows, 3), m, target frame; x runs fastest."""
        x = self.first[0] + self.square * np.arange(self.columns)
        y = self.first[1] + self.square * np.arange(self.rows)
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        return np.column_stack([grid, np.zeros(len(grid))])

    def labellings(self):
        """(m, n) indices into corners(): each row a way to number a detected grid.

        A grid may be read from any of its ends, and a square one by columns as well; mirrored
        readings are among them and lose against the prediction. Where the first square's colour is
        stated, detect() begins at such a square, and readings that begin at the other are left out.
        """
        grid = np.arange(self.columns * self.rows).reshape(self.rows, self.columns)
        shifts = {(0, 0): grid, (1, 1): grid[::-1, ::-1], (0, 1): grid[::-1], (1, 0): grid[:, ::-1]}
        stated = self.first_square is not None
        flips = [
            turned
            for (x, y), turned in shifts.items()
            if not (stated and (x * self.columns + y * self.rows) % 2)
        ]
        if self.columns == self.rows:
            flips += [f.T for f in flips]
        return np.stack([f.reshape(-1) for f in flips])

    def detect(self, grey):
        """(n, 2) sub-pixel corners in a grey image (h, w) uint8, or None.

        The disc of the refinement is at most 0.4 of the smallest spacing of neighbours, so that no
        other corner is ever inside it; a corner that does not settle refuses the whole grid.
        """
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, corners = cv2.findChessboardCorners(grey, (self.columns, self.rows), flags=flags)
        if not found:
            return None
        uv = corners[:, 0].astype(float)
        radius = float(np.clip(0.4 * self._spacing(uv), 2.5, 10))
        refined, settled = subpixel.refine(grey, uv, radius)
        return self._from_stated_colour(grey, refined) if settled.all() else None

    def _from_stated_colour(self, grey, uv):
        """Corners (n, 2) renumbered to begin at a square of the stated colour, or None."""
        grid = uv.reshape(self.rows, self.columns, 2)
        if self.first_square is None or self._first_colour(grey, grid) == self.first_square:
            return uv
        if (self.columns + self.rows) % 2:
            return uv[::-1]
        # All ends of an even pattern have one colour: a grid that has another is off by a square.
        return grid[:, ::-1].reshape(-1, 2) if self.columns % 2 else None

    def _first_colour(self, grey, grid):
        """Colour of the square within the first four corners, which is that of the first one."""
        u, v = np.rint(grid[:2, :2].mean((0, 1))).astype(int)
        u_next, v_next = np.rint(grid[:2, 1:3].mean((0, 1))).astype(int)
        return "black" if grey[v, u] < grey[v_next, u_next] else "white"

    def _spacing(self, uv):
        grid = uv.reshape(self.rows, self.columns, 2)
        along = np.linalg.norm(np.diff(grid, axis=1), axis=-1)
        across = np.linalg.norm(np.diff(grid, axis=0), axis=-1)
        return min(along.min(), across.min())
