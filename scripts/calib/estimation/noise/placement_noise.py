"""Whether the noise differs between placements by more than chance: blurred or distant views."""

import numpy as np
from scipy.special import digamma, polygamma
from scipy.stats import chi2

SPREAD_TEST_LEVEL = 0.99  # of the test that the placements' noise differs


def excess_spread(mean_squares: np.ndarray, dof: np.ndarray) -> float:
    """Return the σ of the logarithm of the variances (n,) of placements, beyond chance.

    mean_squares (n,): of dof (n,) residuals each. As some differ much by chance, the scatter of the
    logarithms is compared with its 99 % quantile: the spread is 0 unless one noise cannot fit all.
    """
    if len(mean_squares) < 3 or np.any(mean_squares <= 0):
        return 0.0
    logs = np.log(mean_squares) - digamma(dof / 2) + np.log(dof / 2)
    chance = polygamma(1, dof / 2)
    mean = np.sum(logs / chance) / np.sum(1 / chance)
    excess = float(np.sum((logs - mean) ** 2 / chance))
    excess -= float(chi2.ppf(SPREAD_TEST_LEVEL, len(logs) - 1))
    return float(np.sqrt(max(0.0, excess) / np.sum(1 / chance)))
