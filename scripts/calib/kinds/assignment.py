"""What an assignment says about every measurement, and the weights that go with it."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Assignment:
    """Per measurement (n,): its feature, -1 for none; whether the geometry alone would admit it;
    sigma; value (n, k), the residual in px, m or rad; range, m, and cosine of incidence; and the
    numbers (n, m) that the residual is computed from, without the weight."""

    feature: np.ndarray
    candidate: np.ndarray
    sigma: np.ndarray
    value: np.ndarray
    range: np.ndarray
    cosine: np.ndarray
    numbers: np.ndarray

    @property
    def data(self):
        """Data (m + 1, n) of the kind's residual; the weight 1/σ is zero for non-members."""
        weight = np.where(self.feature >= 0, 1 / self.sigma, 0.0)
        return np.column_stack([self.numbers, weight]).T

    @property
    def size(self):
        """Residuals (n,) in σ."""
        return np.linalg.norm(self.value, axis=1) / self.sigma


def taper(beyond, width):
    """0 at and below a limit, 1 from width beyond it on, linear between."""
    return np.clip(beyond / width, 0, 1)


def loss_weight(size, gate):
    """Weight (n,) of Tukey's biweight for residuals of a size (n,), in σ; 0 from the gate on."""
    return np.maximum(1 - (size / gate) ** 2, 0) ** 2
