"""Part of a camera's image, and where its pixels lie on a plane before the camera."""

from dataclasses import dataclass

import cv2
import numpy as np

MIN_PLANE_CELLS = 6  # cells: four fit any plane
MAX_PLANE_MISFIT_SHARE = (
    0.15  # of the spacing: seeds of which half are farther from one plane are no grid
)


@dataclass(frozen=True)
class ImageRegion:
    """Grey levels (h, w) uint8 of a camera's image from its pixel offset (2,) on."""

    grey: np.ndarray
    camera: object
    offset: np.ndarray

    def unproject(self, uv):
        """Unit rays (n, 3) of the region's pixels (n, 2), and where there are any (n,)."""
        return self.camera.unproject(np.asarray(uv) + self.offset)

    def project(self, rays):
        """The region's pixels (n, 2) of rays (n, 3), and where there are any (n,)."""
        uv, ok = self.camera.project(rays)
        return uv - self.offset, ok


@dataclass(frozen=True)
class GridPlane:
    """A plane with a grid seen through a lens: ray ~ axes · H · (column, row, 1)."""

    region: ImageRegion
    axes: np.ndarray
    homography: np.ndarray

    @classmethod
    def fit_cells(cls, region, cells, uv):
        """The plane that half or more of the pixels uv (n, 2) of cells (n, 2) agree on, or None."""
        rays, ok = region.unproject(uv)
        if len(rays) < MIN_PLANE_CELLS or not ok.all():
            return None
        axes = np.linalg.svd(np.eye(3) - np.outer(m := rays.mean(0), m) / (m @ m))[0]
        axes[:, 2] *= np.sign(axes[:, 2] @ m)
        flat = rays @ axes
        if (flat[:, 2] < 0.2).any():
            return None
        H, _ = cv2.findHomography(cells.astype(float), flat[:, :2] / flat[:, 2:], cv2.LMEDS)
        return None if H is None else cls(region, axes, H)

    def project_cells(self, cells):
        """The region's pixels (..., 2) of cells (..., 2); NaN where there are none."""
        cells = np.asarray(cells, float)
        flat = np.concatenate([cells, np.ones((*cells.shape[:-1], 1))], -1) @ self.homography.T
        uv, ok = self.region.project(flat.reshape(-1, 3) @ self.axes.T)
        uv[~ok | (flat.reshape(-1, 3)[:, 2] <= 0)] = np.nan
        return uv.reshape(cells.shape)

    def cell_sides(self, cells):
        """The ways (n, 2), px, from cells (n, 2) to the next column and to the next row."""
        half = 0.5 * np.eye(2)
        return [self.project_cells(cells + h) - self.project_cells(cells - h) for h in half]


def make_grid_cells(columns, rows, beyond=0):
    """Cells (rows, columns, 2) as (column, row), and so many more on every side."""
    i, j = (np.arange(-beyond, n + beyond) for n in (columns, rows))
    return np.stack(np.meshgrid(i, j), -1)
