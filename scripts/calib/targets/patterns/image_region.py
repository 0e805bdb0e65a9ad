"""Part of a camera's image, and where its pixels lie on a plane before the camera."""

from dataclasses import dataclass
from typing import Optional, Protocol

import cv2
import numpy as np

MIN_PLANE_CELLS = 6  # four cells fit any plane
MAX_PLANE_MISFIT_SHARE = 0.15  # of the spacing; the median distance of a grid's seeds from a plane
MIN_AXIS_COSINE = 0.2  # between a ray to a cell and the mean ray


class CameraProjection(Protocol):
    """What patterns need of a camera."""

    def project(self, p_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixels (n, 2) of points (n, 3), and which are valid (n,)."""

    def unproject(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the unit rays (n, 3) of pixels (n, 2), and which are valid (n,)."""


@dataclass(frozen=True)
class ImageRegion:
    """Grey levels (h, w) uint8 of a camera's image from its pixel offset (2,) on."""

    grey: np.ndarray
    camera: CameraProjection
    offset: np.ndarray

    def unproject(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the unit rays (n, 3) of the region's pixels (n, 2), and which are valid (n,)."""
        return self.camera.unproject(np.asarray(uv) + self.offset)

    def project(self, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the region's pixels (n, 2) of rays (n, 3), and which are valid (n,)."""
        uv, is_valid = self.camera.project(rays)
        return uv - self.offset, is_valid


@dataclass(frozen=True)
class GridPlane:
    """A plane with a grid seen through a lens: ray ~ axes · homography · (column, row, 1)."""

    region: ImageRegion
    axes: np.ndarray
    homography: np.ndarray

    @classmethod
    def fit_cells(
        cls, region: ImageRegion, cells: np.ndarray, uv: np.ndarray
    ) -> Optional["GridPlane"]:
        """Fit the plane that at least half of the pixels uv (n, 2) of cells (n, 2) agree on.

        Returns None if there is none.
        """
        rays, is_valid = region.unproject(uv)
        if len(rays) < MIN_PLANE_CELLS or not is_valid.all():
            return None
        mean = rays.mean(0)
        axes = np.linalg.svd(np.eye(3) - np.outer(mean, mean) / (mean @ mean))[0]
        axes[:, 2] *= np.sign(axes[:, 2] @ mean)
        flat = rays @ axes
        if (flat[:, 2] < MIN_AXIS_COSINE).any():
            return None
        H, _ = cv2.findHomography(cells.astype(float), flat[:, :2] / flat[:, 2:], cv2.LMEDS)
        return None if H is None else cls(region, axes, H)

    def project_cells(self, cells: np.ndarray) -> np.ndarray:
        """Return the region's pixels (..., 2) of cells (..., 2); NaN where there are none."""
        cells = np.asarray(cells, float)
        flat = np.concatenate([cells, np.ones((*cells.shape[:-1], 1))], -1) @ self.homography.T
        uv, is_valid = self.region.project(flat.reshape(-1, 3) @ self.axes.T)
        uv[~is_valid | (flat.reshape(-1, 3)[:, 2] <= 0)] = np.nan
        return uv.reshape(cells.shape)

    def cell_sides(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the vectors (n, 2), px, from cells (n, 2) to the next column and the next row."""
        along, across = (
            self.project_cells(cells + half) - self.project_cells(cells - half)
            for half in 0.5 * np.eye(2)
        )
        return along, across


def make_grid_cells(columns: int, rows: int, n_beyond: int = 0) -> np.ndarray:
    """Return the cells (rows, columns, 2) of a grid as (column, row).

    n_beyond more are added on every side.
    """
    i, j = (np.arange(-n_beyond, n + n_beyond) for n in (columns, rows))
    return np.stack(np.meshgrid(i, j), -1)
