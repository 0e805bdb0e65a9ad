"""The result of assigning measurements to features of a target, with their noise and weights."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from calib.estimation.residuals.robust_loss import tukey_weight
from calib.geometry.numpy_or_casadi import ArrayOrExpression

Keypoints: TypeAlias = Mapping[str, np.ndarray]  # columns of keypoints.parquet, n rows

# (R (3, 3), t (3), data (m + 1)) -> residual (k) in units of σ; all of them CasADi expressions.
ResidualExpression: TypeAlias = Callable[
    [ArrayOrExpression, ArrayOrExpression, ArrayOrExpression], ArrayOrExpression
]


class Noise(NamedTuple):
    """Noise of one kind of measurement by one sensor, in units of the keypoints' own σ.

    white: independent for every measurement; common: shared by all measurements of a repeat group,
    so that repetition does not average it away.
    """

    white: float
    common: float

    @property
    def total(self) -> float:
        """Return the σ of both together."""
        return float(np.hypot(self.white, self.common))


@dataclass(frozen=True)
class Assignment:
    """Measurements (n,) of one kind by one sensor in one placement, assigned to a target.

    candidate_feature: feature that each would belong to, -1 for none; geometric_weight: 0, where
    the geometry excludes it, to 1; repeat_group: number of the set of measurements that every scan
    or image repeats; keypoint_sigma: its own σ, px, m or rad; residual (n, k); range, m;
    cos_incidence; data (n, m): the data columns of the kind, without the weight; noise: over
    keypoint_sigma; gate_sigma: the gate, in σ. whitening (n, 3): a, b, c of the triangular matrix
    [[a, b], [0, c]] that makes residuals (n, 2) with correlated errors independent, keypoint_sigma
    each; None where they are.
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

    def with_noise(self, noise: Noise) -> "Assignment":
        """Return the same assignment with another noise."""
        return replace(self, noise=noise)

    @cached_property
    def is_candidate(self) -> np.ndarray:
        """Return which measurements (n,) the geometry admits."""
        return (self.candidate_feature >= 0) & (self.geometric_weight > 0)

    @cached_property
    def sigma(self) -> np.ndarray:
        """Return the σ (n,) of every measurement, px, m or rad."""
        return self.keypoint_sigma * self.noise.total

    @cached_property
    def residual_over_sigma0(self) -> np.ndarray:
        """Return the residuals (n, k), whitened, over keypoint_sigma."""
        if self.whitening is None:
            return self.residual / self.keypoint_sigma[:, None]
        a, b, c = self.whitening.T
        u, v = self.residual.T
        return np.column_stack([a * u + b * v, c * v]) / self.keypoint_sigma[:, None]

    @cached_property
    def standardized(self) -> np.ndarray:
        """Return the residuals (n, k) in σ."""
        return self.residual_over_sigma0 / self.noise.total

    @cached_property
    def standardized_norm(self) -> np.ndarray:
        """Return the length (n,) of the residuals in σ."""
        return np.linalg.norm(self.standardized, axis=1)

    @cached_property
    def feature(self) -> np.ndarray:
        """Return the feature (n,) of every inlier, -1 for the others."""
        return np.where(
            self.is_candidate & (self.standardized_norm < self.gate_sigma),
            self.candidate_feature,
            -1,
        )

    @cached_property
    def effective_weight(self) -> np.ndarray:
        """Return the weight (n,) in the cost: geometric, less what a measurement repeats.

        m measurements of variance w² + c², with c² in common, hold as much information as
        m / (1 + (m - 1) k) independent ones, k = c² / (w² + c²).
        """
        among = np.bincount(self.repeat_group, self.geometric_weight)[self.repeat_group]
        white, common = np.square(self.noise) / self.noise.total**2
        return self.geometric_weight / (white + common * np.maximum(among, 1.0))

    @cached_property
    def weight(self) -> np.ndarray:
        """Return the weight (n,) in the information: effective times robust; 0 for outliers."""
        return np.where(
            self.feature >= 0,
            self.effective_weight * tukey_weight(self.standardized_norm, self.gate_sigma),
            0.0,
        )

    @property
    def weighted_data(self) -> np.ndarray:
        """Return the data columns (m + 1, n) of the kind; the last, 1/σ, is 0 for outliers."""
        weight = np.where(self.feature >= 0, 1 / self.sigma, 0.0)
        return np.column_stack([self.data, weight]).T


def taper_weight(beyond: np.ndarray, width: float) -> np.ndarray:
    """Return a weight (n,) that rises from 0 at a limit to 1 where `beyond` (n,) is `width`."""
    return np.clip(beyond / width, 0, 1)


def number_repeat_groups(*parts: np.ndarray) -> np.ndarray:
    """Number every combination (n,) of whole numbers (n,) of small range."""
    number = np.zeros(len(parts[0]), int)
    for part in parts:
        part = np.asarray(part, int) - int(np.min(part, initial=0))
        number = number * (int(np.max(part, initial=0)) + 1) + part
    return number
