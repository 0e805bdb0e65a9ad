"""What an assignment says about every measurement, and the noise and weights that go with it."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.estimation.residuals.robust_loss import tukey_weight


class Noise(NamedTuple):
    """Noise of one kind by one sensor, in units of its keypoints' own σ.

    white: what is drawn anew for every measurement; common: what all measurements of one cell share
    and no repetition averages away.
    """

    white: float
    common: float

    @property
    def total(self):
        return float(np.hypot(self.white, self.common))


@dataclass(frozen=True)
class Assignment:
    """Measurements (n,) of one kind by one sensor in one placement, against its target.

    nearest: the feature each would belong to; trust: from 0, where the geometry rules it out, to 1;
    cell: what repeats in every scan or image, by number; own: σ it came with, px, m or rad; value
    (n, k): the residual; range, m, and cosine of incidence; numbers (n, m) that the residual is
    computed from, without the weight; noise over own; gate, in σ. whiten (n, 3): a, b, c of the
    triangle [[a, b], [0, c]] that makes values (n, 2) of unequal or correlated errors of one size,
    σ per axis; None where they are so already.
    """

    candidate_feature: np.ndarray
    geometric_weight: np.ndarray
    repeat_group: np.ndarray
    keypoint_sigma: np.ndarray
    residual: np.ndarray
    range: np.ndarray
    cos_incidence: np.ndarray
    data: np.ndarray
    noise: Noise
    gate_sigma: float
    whitening: np.ndarray | None = None

    def with_noise(self, noise):
        """The same at another noise."""
        return replace(self, noise=noise)

    @cached_property
    def is_candidate(self):
        """Which the geometry admits."""
        return (self.candidate_feature >= 0) & (self.geometric_weight > 0)

    @cached_property
    def sigma(self):
        return self.keypoint_sigma * self.noise.total

    @cached_property
    def residual_over_sigma0(self):
        """Residuals (n, k) in units of own."""
        if self.whitening is None:
            return self.residual / self.keypoint_sigma[:, None]
        a, b, c = self.whitening.T
        u, v = self.residual.T
        return np.column_stack([a * u + b * v, c * v]) / self.keypoint_sigma[:, None]

    @cached_property
    def standardized(self):
        """Residuals (n, k) in σ."""
        return self.residual_over_sigma0 / self.noise.total

    @cached_property
    def standardized_norm(self):
        """Residuals (n,) in σ."""
        return np.linalg.norm(self.standardized, axis=1)

    @cached_property
    def feature(self):
        """Feature (n,) that each belongs to, -1 for none."""
        return np.where(
            self.is_candidate & (self.standardized_norm < self.gate_sigma),
            self.candidate_feature,
            -1,
        )

    @cached_property
    def effective_weight(self):
        """Weight (n,) of each in the cost: its trust, less what it repeats of its cell.

        m measurements of variance w² + c² with c² in common tell as much as m / (1 + (m - 1) k) of
        them, k = c² / (w² + c²).
        """
        among = np.bincount(self.repeat_group, self.geometric_weight)[self.repeat_group]
        white, common = np.square(self.noise) / self.noise.total**2
        return self.geometric_weight / (white + common * np.maximum(among, 1.0))

    @cached_property
    def weight(self):
        """Weight (n,) of each in the information: its share, robustly; 0 for non-members."""
        return np.where(
            self.feature >= 0,
            self.effective_weight * tukey_weight(self.standardized_norm, self.gate_sigma),
            0.0,
        )

    @property
    def weighted_data(self):
        """Data (m + 1, n) of the kind's residual; the weight 1/σ is zero for non-members."""
        weight = np.where(self.feature >= 0, 1 / self.sigma, 0.0)
        return np.column_stack([self.data, weight]).T


def number_repeat_groups(*parts):
    """Number (n,) of each combination of the parts (n,), whole numbers of small range."""
    number = np.zeros(len(parts[0]), int)
    for part in parts:
        part = np.asarray(part, int) - int(np.min(part, initial=0))
        number = number * (int(np.max(part, initial=0)) + 1) + part
    return number
