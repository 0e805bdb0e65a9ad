"""What corner residuals have in common between placements: the cause of their scatter.

The error of a lens repeats at the same place of the image, that of a board or its print at the same
corner, whatever the placement. Blur and motion repeat nowhere, but differ between placements.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.estimation.noise.placement_noise import excess_spread
from calib.estimation.residuals.assignment import number_repeat_groups

N_IMAGE_CELLS = 12  # along the longer side of the image
MIN_SHARE = 0.1  # of the variance, below which a repetition is no cause
MIN_SIGNIFICANCE = 4.0  # of a mean product of residuals, in its standard error
MIN_SPREAD = 0.3  # σ of the logarithm of the noise of placements, above which they differ


class CornerResiduals(NamedTuple):
    """Residuals of corners over all placements.

    residual (n, 2), placement (n,), corner (n,): number of the target's corner, uv (n, 2), px.
    """

    residual: np.ndarray
    placement: np.ndarray
    corner: np.ndarray
    uv: np.ndarray


class RepeatedShares(NamedTuple):
    """Shares of the variance that repeat in all placements, by place in the image and on a target.

    views: σ of the logarithm of the noise of placements, beyond chance. Each is 0 where it is not
    significant.
    """

    image: float
    target: float
    views: float


def repeated_shares(corners: CornerResiduals, size_px: Sequence[int]) -> RepeatedShares:
    """Return how much of the residuals repeats, and by how much placements differ."""
    cell_px = max(size_px) / N_IMAGE_CELLS
    image_cell = number_repeat_groups(*np.floor(corners.uv / cell_px).astype(int).T)
    return RepeatedShares(
        repeated_share(corners.residual, corners.placement, image_cell),
        repeated_share(corners.residual, corners.placement, corners.corner),
        _placement_spread(corners),
    )


def repeated_share(residual: np.ndarray, placement: np.ndarray, place: np.ndarray) -> float:
    """Return the share of the variance of residuals (n, 2) that a place (n,) repeats; 0 by chance.

    It is the mean product of residuals at the same place in two placements, over their mean square.
    A pair of placements counts as one sample, as the errors within it are not independent.
    """
    products, counts = _pair_products(residual, placement, place)
    n_pairs, mean_square = counts.sum(), float(np.mean(np.sum(residual**2, 1)))
    error = np.sqrt(np.sum(products**2))
    if not n_pairs or products.sum() < MIN_SIGNIFICANCE * error or mean_square == 0:
        return 0.0
    share = float(products.sum() / n_pairs / mean_square)
    return share if share > MIN_SHARE else 0.0


def _pair_products(
    residual: np.ndarray, placement: np.ndarray, place: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return sums of products of mean residuals, and their numbers, by pair of placements."""
    p, n_p = _number(placement)
    k, n_k = _number(place)
    cell = p * n_k + k
    count = np.bincount(cell, minlength=n_p * n_k)
    sums = [np.bincount(cell, r, minlength=n_p * n_k) for r in residual.T]
    means = [(s / np.maximum(count, 1)).reshape(n_p, n_k) for s in sums]
    is_seen = (count > 0).reshape(n_p, n_k).astype(float)
    upper = np.triu_indices(n_p, 1)
    products = sum(m @ m.T for m in means)
    return np.asarray(products)[upper], (is_seen @ is_seen.T)[upper]


def _placement_spread(corners: CornerResiduals) -> float:
    p, n = _number(corners.placement)
    squares = np.bincount(p, np.sum(corners.residual**2, 1), minlength=n)
    dof = 2.0 * np.bincount(p, minlength=n) - 6  # the pose of a placement follows its corners
    is_free = dof > 2
    spread = excess_spread(squares[is_free] / dof[is_free], dof[is_free]) / 2
    return spread if spread > MIN_SPREAD else 0.0


def _number(values: np.ndarray) -> tuple[np.ndarray, int]:
    """Return values (n,) as numbers from 0, and how many different ones there are."""
    unique, number = np.unique(values, return_inverse=True)
    return number, len(unique)
