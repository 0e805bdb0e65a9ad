"""A printed checkerboard: inner corners in rows along +x, rows along +y, in the plane z = 0."""

from dataclasses import dataclass, replace

import numpy as np

from calib.io.status import OK, Status, failed
from calib.targets.patterns import asymmetric_edges, edge_model, grid_growing, opencv_grids
from calib.targets.patterns.detected_corners import Corners
from calib.targets.patterns.image_region import Plane, Region, lattice

NEAR = 0.15  # of the spacing: a seed farther from the grid's plane than this is replaced by it
RESIDUE = 1.3  # of the grid's median residual: what leaves more is covered by something,
UNLIKE = 0.02  # unless that more is no more than this share of the saddle, as no model is perfect
CONTRAST = 0.5  # of the grid's median saddle: what has less is covered or no crossing
ASIDE = 6.0  # σ of the grid's scatter, by its median, about its plane
FEWEST = 0.5  # of all corners
ROUNDING = 12**-0.5  # grey levels


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

    name, share = "checkerboard", 1.0

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

    def scaled(self, factor):
        middle = self.corners()[:, :2].mean(0)
        first = middle + factor * (np.asarray(self.first) - middle)
        return replace(self, square=self.square * factor, first=tuple(first))

    def labellings(self):
        """(m, n) indices into corners(): each row a way to number a detected grid.

        A grid may be read from any of its ends, and a square one by columns as well; mirrored
        readings are among them and lose against the prediction. Where the first square's colour is
        stated, a grid begins at such a square, and readings that begin at the other are left out.
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
        """All corners (n, 2) of a grey image (h, w) uint8 to a third of a pixel, or None: the first
        whole grid that is found, unchecked but for the colours."""
        for find in (opencv_grids.quick, opencv_grids.by_sectors):
            uv = self._upright(find(grey, self.columns, self.rows))
            if uv is not None:
                sides = [np.gradient(uv, axis=a).reshape(-1, 2) for a in (1, 0)]
                saddle, _ = grid_growing.quadrants(grey, uv.reshape(-1, 2), *sides)
                parity = (-1.0) ** lattice(self.columns, self.rows).sum(-1).reshape(-1)
                uv = self._from_stated_colour(uv, np.nansum(parity * saddle))
                return None if uv is None else uv.reshape(-1, 2)
        return None

    def _upright(self, uv):
        """A grid (r, c, 2) as (rows, columns, 2), or None where it has another size."""
        if uv is not None and uv.shape[:2] != (self.rows, self.columns):
            uv = np.swapaxes(uv, 0, 1)
        return uv if uv is not None and uv.shape[:2] == (self.rows, self.columns) else None

    def locate(self, grey, camera, offset):
        """(Corners, Status) of the grid in a grey region (h, w) uint8 whose first pixel is at
        offset (2,) of the camera's image; no Corners, and why, where there is none.

        Every way of looking is tried until a grid stands the checks: it lies on a plane, is made of
        crossings by turns, and ends where it should. Its corners are then fitted, and those that
        something covers are left out.
        """
        region, seen = Region(grey, camera, np.asarray(offset, float)), {}
        for seeds in opencv_grids.candidates(grey, self.columns, self.rows):
            if seeds is not None:
                corners, found = self._verified(region, seeds)
                if corners:
                    return corners, found
                seen[found] = None
        size = f"{grey.shape[1]} x {grey.shape[0]} px"
        found = ", ".join(seen) or "none"
        return None, failed(f"no {self.name} in the region of {size}", found, self.expected)

    def _verified(self, region, seeds):
        """(Corners, Status) of a candidate (r, c, 2), or None and what it is instead."""
        settled = grid_growing.settle(region, seeds, edge_model.refine)
        if settled is None:
            return None, "a grid that lies on no plane or is none"
        uv, sign = settled
        if self._upright(uv) is None:
            return None, "{1} × {0} inner corners".format(*sorted(uv.shape[:2]))
        uv = self._from_stated_colour(self._upright(uv), sign)
        if uv is None:
            return None, f"a grid whose ends are not {self.first_square}"
        return self._fitted(region, uv)

    def _from_stated_colour(self, uv, sign):
        """Grid (rows, columns, 2) turned to begin at a square of the stated colour, or None.

        sign: of the saddle of its first corner, positive where the square within the first four
        corners, which has the colour of the first one, is white.
        """
        if self.first_square in (None, "white" if sign > 0 else "black"):
            return uv
        if (self.columns + self.rows) % 2:
            return uv[::-1, ::-1]
        # All ends of an even pattern have one colour: a grid that has another is off by a square.
        return uv[:, ::-1] if self.columns % 2 else None

    def _fitted(self, region, uv):
        """(Corners, Status) of a grid (rows, columns, 2), px of the region."""
        cells = lattice(self.columns, self.rows).reshape(-1, 2)
        plane = Plane.through(region, cells, uv.reshape(-1, 2))
        if plane is None:
            return None, "a grid that lies on no plane"
        sides = plane.sides(cells)
        fit = edge_model.refine(region, _near(plane, cells, uv.reshape(-1, 2), sides), *sides)
        fit = asymmetric_edges.corrected(region, fit, *sides)
        good = uncovered(region, cells, fit)
        n, kept = len(good), int(good.sum())
        if kept < FEWEST * n:
            return None, f"{kept} of {n} corners that are clear"
        noise = max(float(np.median(fit.rms[good])), ROUNDING)
        rejected = Status(reason=f"{n - kept} of {n} corners are covered") if kept < n else OK
        found = fit.uv[good] + region.offset
        return Corners(np.flatnonzero(good), found, noise**2 * fit.covariance[good]), rejected


def _near(plane, cells, uv, sides):
    """The seeds (n, 2), those away from the plane that most lie on replaced by it."""
    predicted = plane.pixels(cells)
    spacing = np.minimum(*(np.linalg.norm(s, axis=1) for s in sides))
    away = np.linalg.norm(uv - predicted, axis=1)
    return np.where((away < NEAR * spacing)[:, None], uv, predicted)


def uncovered(region, cells, fit):
    """Which corners (n,) are like the rest: settled, of the right colours, with no more residual
    than most, and on one plane with them."""
    parity = (-1.0) ** cells.sum(1)
    saddle = parity * fit.saddle
    good = fit.ok & np.isfinite(fit.uv).all(1)
    if not good.any():
        return good
    middle = np.median(saddle[good])
    good &= saddle * np.sign(middle) > CONTRAST * abs(middle)
    good &= fit.rms < np.hypot(RESIDUE * np.median(fit.rms[good]), UNLIKE * abs(middle))
    plane = Plane.through(region, cells[good], fit.uv[good])
    if plane is None:
        return np.zeros(len(cells), bool)
    off = np.linalg.norm(plane.pixels(cells) - fit.uv, axis=1)
    sigma = np.median(fit.rms[good]) * np.sqrt(np.trace(fit.covariance, axis1=1, axis2=2) / 2)
    scatter = max(1.0, np.median((off / sigma)[good]) / 1.1774)  # median of a Rayleigh variable
    return good & (off < ASIDE * scatter * sigma)
