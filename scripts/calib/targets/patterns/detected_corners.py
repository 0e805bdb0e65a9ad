"""What a pattern's detector returns."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class DetectedCorners:
    """Corners found in an image.

    corner_index: (n,) place in the detected grid; uv: (n, 2) pixels of the whole image;
    covariance: (n, 2, 2), px².
    """

    corner_index: np.ndarray
    uv: np.ndarray
    covariance: np.ndarray

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation (n,) per axis, px: the root of the mean variance."""
        return np.sqrt(np.trace(self.covariance, axis1=1, axis2=2) / 2)

    @property
    def whitening(self) -> np.ndarray:
        """Return a, b, c (n, 3) of the triangle W = [[a, b], [0, c]] with WᵀW = σ² Σ⁻¹.

        Both parts of a whitened residual W e have the standard deviation σ.
        """
        shape = np.linalg.inv(self.covariance) * self.sigma[:, None, None] ** 2
        L = np.linalg.cholesky(shape)
        return np.stack([L[:, 0, 0], L[:, 1, 0], L[:, 1, 1]], -1)
