"""A printed checkerboard: inner corners in rows along +x, rows along +y, in the plane z = 0."""

from dataclasses import dataclass, replace

import numpy as np

from calib.io.status import OK, Status, failure_status
from calib.targets.patterns.asymmetric_edges import fix_asymmetric_edges
from calib.targets.patterns.detected_corners import DetectedCorners
from calib.targets.patterns.edge_model import fit_corner_edges
from calib.targets.patterns.grid_growing import grow_and_trim_grid, measure_saddles
from calib.targets.patterns.image_region import GridPlane, ImageRegion, make_grid_cells
from calib.targets.patterns.opencv_grids import (
    find_grid_by_sectors,
    find_grid_fast,
    iterate_grid_candidates,
)

MAX_SEED_DISTANCE_SHARE = (
    0.15  # of the spacing: a seed farther from the grid's plane than this is replaced by it
)
MAX_RESIDUAL_RATIO = 1.3  # of the grid's median residual: what leaves more is covered by something,
MAX_RESIDUAL_TO_SADDLE = (
    0.02  # unless that more is no more than this share of the saddle, as no model is perfect
)
MIN_SADDLE_RATIO = 0.5  # of the grid's median saddle: what has less is covered or no crossing
MAX_OFF_PLANE_SIGMAS = 6.0  # σ of the grid's scatter, by its median, about its plane
MIN_CORNER_SHARE = 0.5  # of all corners
GREY_ROUNDING_RMS = 12**-0.5  # grey levels


@dataclass(frozen=True)
class Checkerboard:
    """columns × rows inner corners, `square` m apart, the first at `first` (x, y), m.

    first_square: colour of the square at the low-x, low-y end, black, white or None (not stated).
    """

    n_columns: int
    n_rows: int
    square_m: float
    first_corner: tuple
    first_square_color: str | None = None

    name, min_visible_share = "checkerboard", 1.0

    @classmethod
    def from_config(cls, config):
        columns, rows = config["inner_corners"]
        first = tuple(config["first_corner_m"])
        return cls(columns, rows, config["square_m"], first, config.get("first_square"))

    @property
    def expected_description(self):
        return f"{self.n_columns} × {self.n_rows} inner corners"

    def corners(self):
        """(columns·rows, 3), m, target frame; x runs fastest."""
        x = self.first_corner[0] + self.square_m * np.arange(self.n_columns)
        y = self.first_corner[1] + self.square_m * np.arange(self.n_rows)
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        return np.column_stack([grid, np.zeros(len(grid))])

    def with_scale(self, factor):
        middle = self.corners()[:, :2].mean(0)
        first = middle + factor * (np.asarray(self.first_corner) - middle)
        return replace(self, square_m=self.square_m * factor, first_corner=tuple(first))

    def corner_orders(self):
        """(m, n) indices into corners(): each row a way to number a detected grid.

        A grid may be read from any of its ends, and a square one by columns as well; mirrored
        readings are among them and lose against the prediction. Where the first square's colour is
        stated, a grid begins at such a square, and readings that begin at the other are left out.
        """
        grid = np.arange(self.n_columns * self.n_rows).reshape(self.n_rows, self.n_columns)
        shifts = {(0, 0): grid, (1, 1): grid[::-1, ::-1], (0, 1): grid[::-1], (1, 0): grid[:, ::-1]}
        stated = self.first_square_color is not None
        flips = [
            turned
            for (x, y), turned in shifts.items()
            if not (stated and (x * self.n_columns + y * self.n_rows) % 2)
        ]
        if self.n_columns == self.n_rows:
            flips += [f.T for f in flips]
        return np.stack([f.reshape(-1) for f in flips])

    def detect_corners_fast(self, grey):
        """All corners (n, 2) of a grey image (h, w) uint8 to a third of a pixel, or None: the first
        whole grid that is found, unchecked but for the colours."""
        for find in (find_grid_fast, find_grid_by_sectors):
            uv = self._orient_grid(find(grey, self.n_columns, self.n_rows))
            if uv is not None:
                sides = [np.gradient(uv, axis=a).reshape(-1, 2) for a in (1, 0)]
                saddle, _ = measure_saddles(grey, uv.reshape(-1, 2), *sides)
                parity = (-1.0) ** make_grid_cells(self.n_columns, self.n_rows).sum(-1).reshape(-1)
                uv = self._align_to_first_square(uv, np.nansum(parity * saddle))
                return None if uv is None else uv.reshape(-1, 2)
        return None

    def _orient_grid(self, uv):
        """A grid (r, c, 2) as (rows, columns, 2), or None where it has another size."""
        if uv is not None and uv.shape[:2] != (self.n_rows, self.n_columns):
            uv = np.swapaxes(uv, 0, 1)
        return uv if uv is not None and uv.shape[:2] == (self.n_rows, self.n_columns) else None

    def locate_corners(self, grey, camera, offset):
        """(Corners, Status) of the grid in a grey region (h, w) uint8 whose first pixel is at
        offset (2,) of the camera's image; no Corners, and why, where there is none.

        Every way of looking is tried until a grid stands the checks: it lies on a plane, is made of
        crossings by turns, and ends where it should. Its corners are then fitted, and those that
        something covers are left out.
        """
        region, seen = ImageRegion(grey, camera, np.asarray(offset, float)), {}
        for seeds in iterate_grid_candidates(grey, self.n_columns, self.n_rows):
            if seeds is not None:
                corners, found = self._verify_grid(region, seeds)
                if corners:
                    return corners, found
                seen[found] = None
        size = f"{grey.shape[1]} x {grey.shape[0]} px"
        found = ", ".join(seen) or "none"
        return None, failure_status(
            f"no {self.name} in the region of {size}", found, self.expected_description
        )

    def _verify_grid(self, region, seeds):
        """(Corners, Status) of a candidate (r, c, 2), or None and what it is instead."""
        settled = grow_and_trim_grid(region, seeds, fit_corner_edges)
        if settled is None:
            return None, "a grid that lies on no plane or is none"
        uv, sign = settled
        if self._orient_grid(uv) is None:
            return None, "{1} × {0} inner corners".format(*sorted(uv.shape[:2]))
        uv = self._align_to_first_square(self._orient_grid(uv), sign)
        if uv is None:
            return None, f"a grid whose ends are not {self.first_square_color}"
        return self._fit_corners(region, uv)

    def _align_to_first_square(self, uv, sign):
        """Grid (rows, columns, 2) turned to begin at a square of the stated colour, or None.

        sign: of the saddle of its first corner, positive where the square within the first four
        corners, which has the colour of the first one, is white.
        """
        if self.first_square_color in (None, "white" if sign > 0 else "black"):
            return uv
        if (self.n_columns + self.n_rows) % 2:
            return uv[::-1, ::-1]
        # All ends of an even pattern have one colour: a grid that has another is off by a square.
        return uv[:, ::-1] if self.n_columns % 2 else None

    def _fit_corners(self, region, uv):
        """(Corners, Status) of a grid (rows, columns, 2), px of the region."""
        cells = make_grid_cells(self.n_columns, self.n_rows).reshape(-1, 2)
        plane = GridPlane.fit_cells(region, cells, uv.reshape(-1, 2))
        if plane is None:
            return None, "a grid that lies on no plane"
        sides = plane.cell_sides(cells)
        fit = fit_corner_edges(
            region, _replace_far_seeds(plane, cells, uv.reshape(-1, 2), sides), *sides
        )
        fit = fix_asymmetric_edges(region, fit, *sides)
        good = is_clear_corner(region, cells, fit)
        n, kept = len(good), int(good.sum())
        if kept < MIN_CORNER_SHARE * n:
            return None, f"{kept} of {n} corners that are clear"
        noise = max(float(np.median(fit.rms[good])), GREY_ROUNDING_RMS)
        rejected = Status(reason=f"{n - kept} of {n} corners are covered") if kept < n else OK
        found = fit.uv[good] + region.offset
        return DetectedCorners(
            np.flatnonzero(good), found, noise**2 * fit.covariance[good]
        ), rejected


def _replace_far_seeds(plane, cells, uv, sides):
    """The seeds (n, 2), those away from the plane that most lie on replaced by it."""
    predicted = plane.project_cells(cells)
    spacing = np.minimum(*(np.linalg.norm(s, axis=1) for s in sides))
    away = np.linalg.norm(uv - predicted, axis=1)
    return np.where((away < MAX_SEED_DISTANCE_SHARE * spacing)[:, None], uv, predicted)


def is_clear_corner(region, cells, fit):
    """Which corners (n,) are like the rest: settled, of the right colours, with no more residual
    than most, and on one plane with them."""
    parity = (-1.0) ** cells.sum(1)
    saddle = parity * fit.saddle
    good = fit.is_valid & np.isfinite(fit.uv).all(1)
    if not good.any():
        return good
    middle = np.median(saddle[good])
    good &= saddle * np.sign(middle) > MIN_SADDLE_RATIO * abs(middle)
    good &= fit.rms < np.hypot(
        MAX_RESIDUAL_RATIO * np.median(fit.rms[good]), MAX_RESIDUAL_TO_SADDLE * abs(middle)
    )
    plane = GridPlane.fit_cells(region, cells[good], fit.uv[good])
    if plane is None:
        return np.zeros(len(cells), bool)
    off = np.linalg.norm(plane.project_cells(cells) - fit.uv, axis=1)
    sigma = np.median(fit.rms[good]) * np.sqrt(np.trace(fit.covariance, axis1=1, axis2=2) / 2)
    scatter = max(1.0, np.median((off / sigma)[good]) / 1.1774)  # median of a Rayleigh variable
    return good & (off < MAX_OFF_PLANE_SIGMAS * scatter * sigma)
