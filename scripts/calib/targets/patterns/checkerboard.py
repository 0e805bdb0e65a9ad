"""A printed checkerboard: inner corners in rows along +x, rows along +y, in the plane z = 0."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.geometry.units import MM_PER_M
from calib.io.status import OK, Status, failure_status
from calib.targets.patterns.asymmetric_edges import fix_asymmetric_edges
from calib.targets.patterns.detected_corners import DetectedCorners
from calib.targets.patterns.edge_model import CornerFit, fit_corner_edges
from calib.targets.patterns.grid_growing import grow_and_trim_grid, measure_saddles
from calib.targets.patterns.image_region import (
    CameraProjection,
    GridPlane,
    ImageRegion,
    make_grid_cells,
)
from calib.targets.patterns.opencv_grids import (
    find_grid_by_sectors,
    find_grid_fast,
    iterate_grid_candidates,
)

# Of the spacing: a seed farther from the grid's plane is replaced by the plane's.
MAX_SEED_DISTANCE_SHARE = 0.15
# Of the grid's median residual: a corner that leaves more is covered by something, unless the
# excess is below the share of the saddle, as no model is perfect.
MAX_RESIDUAL_RATIO = 1.3
MAX_RESIDUAL_TO_SADDLE = 0.02
MIN_SADDLE_RATIO = 0.5  # of the grid's median saddle; less is covered or no crossing
MAX_OFF_PLANE_SIGMAS = 6.0  # σ of the grid's scatter, by its median, about its plane
RAYLEIGH_MEDIAN = 1.1774  # of a distance in the plane, in σ of one axis
MIN_CORNER_SHARE = 0.5  # of all corners
GREY_ROUNDING_RMS = 12**-0.5  # grey levels


@dataclass(frozen=True)
class Checkerboard:
    """n_columns × n_rows inner corners; see TargetPattern for its members.

    square_m: side of a square; first_corner: (x, y), m; first_square_color: colour of the square at
    the low-x, low-y end, black, white or None (not stated).
    """

    n_columns: int
    n_rows: int
    square_m: float
    first_corner: tuple[float, ...]
    first_square_color: str | None = None

    name = "checkerboard"
    min_visible_share = 1.0

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> "Checkerboard":
        """Make the pattern of a target's `pattern` block."""
        columns, rows = config["inner_corners"]
        return cls(
            n_columns=columns,
            n_rows=rows,
            square_m=config["square_m"],
            first_corner=tuple(config["first_corner_m"]),
            first_square_color=config.get("first_square"),
        )

    @property
    def expected_description(self) -> str:
        return f"{self.n_columns} × {self.n_rows} inner corners"

    @property
    def outline(self) -> np.ndarray:
        low = np.array(self.first_corner) - self.square_m
        high = low + self.square_m * np.array([self.n_columns + 1, self.n_rows + 1])
        return np.array([low, [high[0], low[1]], high, [low[0], high[1]]])

    @property
    def print_description(self) -> str:
        return (
            f"{self.n_columns} × {self.n_rows} inner corners along x × y, "
            f"squares of {MM_PER_M * self.square_m:g} mm"
        )

    def black_rectangles(self) -> np.ndarray:
        """See TargetPattern. The square at the low end is black unless stated otherwise."""
        cells = make_grid_cells(self.n_columns + 1, self.n_rows + 1).reshape(-1, 2)
        first_black = 1 if self.first_square_color == "white" else 0
        low = self.outline[0] + self.square_m * cells[cells.sum(1) % 2 == first_black]
        return np.stack([low, low + self.square_m], axis=1)

    def corners(self) -> np.ndarray:
        """Return all corners (n_columns·n_rows, 3); x runs fastest."""
        x = self.first_corner[0] + self.square_m * np.arange(self.n_columns)
        y = self.first_corner[1] + self.square_m * np.arange(self.n_rows)
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        return np.column_stack([grid, np.zeros(len(grid))])

    def darkness(self, xy: np.ndarray) -> np.ndarray:
        cell = np.floor((xy - self.outline[0]) / self.square_m).astype(int)
        counts = [self.n_columns + 1, self.n_rows + 1]
        is_square = np.all((cell >= 0) & (cell < counts), axis=1)
        is_odd = cell.sum(1) % 2 == 1
        colours = np.column_stack([is_square & ~is_odd, is_square & is_odd]).astype(float)
        if self.first_square_color is None:
            return colours
        return colours[:, :1] if self.first_square_color == "black" else colours[:, 1:]

    def with_scale(self, factor: float) -> "Checkerboard":
        middle = self.corners()[:, :2].mean(0)
        first = middle + factor * (np.asarray(self.first_corner) - middle)
        return replace(self, square_m=self.square_m * factor, first_corner=tuple(first))

    def corner_orders(self) -> np.ndarray:
        """Return (k, n) indices into corners(): each row a way to number a detected grid.

        A grid may be read from any of its ends, and a square one by columns as well. Mirrored
        readings are among them and lose against the prediction. If the first square's colour is
        stated, a grid begins at such a square, and readings from another one are left out.
        """
        grid = np.arange(self.n_columns * self.n_rows).reshape(self.n_rows, self.n_columns)
        # By the end that a grid is read from: whether it is the other end along x, and along y.
        readings = {
            (0, 0): grid,
            (1, 1): grid[::-1, ::-1],
            (0, 1): grid[::-1],
            (1, 0): grid[:, ::-1],
        }
        is_colour_stated = self.first_square_color is not None
        orders = [
            reading
            for (x, y), reading in readings.items()
            if not (is_colour_stated and (x * self.n_columns + y * self.n_rows) % 2)
        ]
        if self.n_columns == self.n_rows:
            orders += [order.T for order in orders]
        return np.stack([order.reshape(-1) for order in orders])

    def detect_corners_fast(self, grey: np.ndarray) -> np.ndarray | None:
        """Return the pixels (n, 2) of the first whole grid that is found, or None.

        Only the colours of its squares are checked.
        """
        for find in (find_grid_fast, find_grid_by_sectors):
            uv = self._orient_grid(find(grey, self.n_columns, self.n_rows))
            if uv is not None:
                along, across = (np.gradient(uv, axis=a).reshape(-1, 2) for a in (1, 0))
                saddle, _ = measure_saddles(grey, uv.reshape(-1, 2), along, across)
                parity = (-1.0) ** make_grid_cells(self.n_columns, self.n_rows).sum(-1).reshape(-1)
                uv = self._align_to_first_square(uv, np.nansum(parity * saddle))
                return None if uv is None else uv.reshape(-1, 2)
        return None

    def _orient_grid(self, uv: np.ndarray | None) -> np.ndarray | None:
        """Return a grid (r, c, 2) as (n_rows, n_columns, 2), or None if it has another size."""
        if uv is not None and uv.shape[:2] != (self.n_rows, self.n_columns):
            uv = np.swapaxes(uv, 0, 1)
        return uv if uv is not None and uv.shape[:2] == (self.n_rows, self.n_columns) else None

    def locate_corners(
        self, grey: np.ndarray, camera: CameraProjection, offset: np.ndarray
    ) -> tuple[DetectedCorners | None, Status]:
        """Return the verified corners of the grid in an image region, or None and why.

        Every detector is tried until a grid passes the checks: it lies on a plane, its crossings
        alternate, and it ends where it should. Its corners are then fitted, and covered ones are
        left out.
        """
        region = ImageRegion(grey, camera, np.asarray(offset, float))
        rejections: dict[str, None] = {}  # in order, each once
        for seeds in iterate_grid_candidates(grey, self.n_columns, self.n_rows):
            if seeds is None:
                continue
            uv, rejection = self._verify_grid(region, seeds)
            if uv is not None:
                corners, rejection = self._fit_corners(region, uv)
                if corners is not None:
                    return corners, self._covered_status(len(corners.corner_index))
            rejections[rejection] = None
        size = f"{grey.shape[1]} x {grey.shape[0]} px"
        found = ", ".join(rejections) or "none"
        return None, failure_status(
            f"no {self.name} in the region of {size}", found, self.expected_description
        )

    def _covered_status(self, n_found: int) -> Status:
        """Return ok, with a note if corners are covered."""
        n = self.n_columns * self.n_rows
        return Status(reason=f"{n - n_found} of {n} corners are covered") if n_found < n else OK

    def _verify_grid(self, region: ImageRegion, seeds: np.ndarray) -> tuple[np.ndarray | None, str]:
        """Return the grid (n_rows, n_columns, 2), px, of seeds (r, c, 2), or what they are."""
        grid = grow_and_trim_grid(region, seeds, fit_corner_edges)
        if grid is None:
            return None, "a grid that lies on no plane or is none"
        uv = self._orient_grid(grid.uv)
        if uv is None:
            columns, rows = sorted(grid.uv.shape[:2], reverse=True)
            return None, f"{columns} × {rows} inner corners"
        uv = self._align_to_first_square(uv, grid.first_sign)
        if uv is None:
            return None, f"a grid whose ends are not {self.first_square_color}"
        return uv, ""

    def _align_to_first_square(self, uv: np.ndarray, sign: float) -> np.ndarray | None:
        """Return a grid (rows, columns, 2) that begins at a square of the stated colour, or None.

        sign: of the saddle of its first corner, positive if the square within the first four
        corners, which has the colour of the first one, is white.
        """
        if self.first_square_color in (None, "white" if sign > 0 else "black"):
            return uv
        if (self.n_columns + self.n_rows) % 2:
            return uv[::-1, ::-1]
        # All ends of an even pattern have one colour: a grid that has another is off by a square.
        return uv[:, ::-1] if self.n_columns % 2 else None

    def _fit_corners(
        self, region: ImageRegion, uv: np.ndarray
    ) -> tuple[DetectedCorners | None, str]:
        """Fit the corners of a grid (rows, columns, 2), px of the region, or say what is wrong."""
        cells = make_grid_cells(self.n_columns, self.n_rows).reshape(-1, 2)
        plane = GridPlane.fit_cells(region, cells, uv.reshape(-1, 2))
        if plane is None:
            return None, "a grid that lies on no plane"
        sides = plane.cell_sides(cells)
        seeds = _replace_far_seeds(plane, cells, uv.reshape(-1, 2), sides)
        fit = fix_asymmetric_edges(region, fit_corner_edges(region, seeds, *sides), *sides)
        is_clear = is_clear_corner(region, cells, fit)
        n, n_clear = len(is_clear), int(is_clear.sum())
        if n_clear < MIN_CORNER_SHARE * n:
            return None, f"{n_clear} of {n} corners that are clear"
        return select_detected_corners(region, fit, is_clear, np.arange(n)), ""


def _replace_far_seeds(
    plane: GridPlane, cells: np.ndarray, uv: np.ndarray, sides: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return the seeds (n, 2); those far from the plane that most lie on are replaced by it."""
    predicted = plane.project_cells(cells)
    spacing = np.minimum(*(np.linalg.norm(s, axis=1) for s in sides))
    distance = np.linalg.norm(uv - predicted, axis=1)
    return np.where((distance < MAX_SEED_DISTANCE_SHARE * spacing)[:, None], uv, predicted)


def is_clear_corner(region: ImageRegion, cells: np.ndarray, fit: CornerFit) -> np.ndarray:
    """Return which corners (n,) of cells (n, 2) agree with the rest.

    Clear corners have converged, have the right colours, leave no more residual than most, and lie
    on one plane.
    """
    parity = (-1.0) ** cells.sum(1)
    saddle = parity * fit.saddle
    is_clear = fit.is_valid & np.isfinite(fit.uv).all(1)
    if not is_clear.any():
        return is_clear
    middle = np.median(saddle[is_clear])
    is_clear &= saddle * np.sign(middle) > MIN_SADDLE_RATIO * abs(middle)
    is_clear &= fit.rms < np.hypot(
        MAX_RESIDUAL_RATIO * np.median(fit.rms[is_clear]), MAX_RESIDUAL_TO_SADDLE * abs(middle)
    )
    plane = GridPlane.fit_cells(region, cells[is_clear], fit.uv[is_clear])
    if plane is None:
        return np.zeros(len(cells), bool)
    distance = np.linalg.norm(plane.project_cells(cells) - fit.uv, axis=1)
    sigma = np.median(fit.rms[is_clear]) * np.sqrt(np.trace(fit.covariance, axis1=1, axis2=2) / 2)
    scatter = max(1.0, np.median((distance / sigma)[is_clear]) / RAYLEIGH_MEDIAN)
    return is_clear & (distance < MAX_OFF_PLANE_SIGMAS * scatter * sigma)


def select_detected_corners(
    region: ImageRegion, fit: CornerFit, is_clear: np.ndarray, corner_index: np.ndarray
) -> DetectedCorners:
    """Return the clear corners (n,) of a fit, with the covariance of the grid's median noise."""
    noise = max(float(np.median(fit.rms[is_clear])), GREY_ROUNDING_RMS)
    uv = fit.uv[is_clear] + region.offset
    return DetectedCorners(corner_index[is_clear], uv, noise**2 * fit.covariance[is_clear])
