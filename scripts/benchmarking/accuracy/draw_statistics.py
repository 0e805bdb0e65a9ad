"""Many results of one case against their truth: how large the errors are, and how honest σ is."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from benchmarking.accuracy import error_metrics
from benchmarking.accuracy.accuracy_cases import SINGLE

LEVEL = 0.95  # of the ellipsoids and of the bands
TRIALS = 20_000  # of the share that an efficient estimator would have above SINGLE


@dataclass(frozen=True)
class Draw:
    """The error (k,) of one result, twists from what was found to the truth, and the covariance
    (k, k) that came with it; None, None where there is no result."""

    error: np.ndarray | None
    covariance: np.ndarray | None


@dataclass(frozen=True)
class Statistics:
    """Over the draws of one case. count: with a result; lost: without; rms, reference, bare: (mm,
    deg), bare being the reference without outlines; worst: the largest error of one draw over the
    reference; beyond: the share of draws above SINGLE times the reference, in mm or deg, and
    usual: that of an efficient estimator; nees: mean of NEES/6; shift: its like, of the mean error;
    held: the share of LEVEL ellipsoids that hold the truth."""

    count: int
    lost: int
    rms: tuple
    reference: tuple
    bare: tuple
    worst: float
    beyond: float
    usual: float
    nees: float
    shift: float
    held: float


def statistics(draws, reference, bare):
    """The Statistics of Draws, of which one at least has a result; reference, bare: covariances
    (6, 6)."""
    good = [d for d in draws if d.error is not None]
    errors, covariances = (np.array([getattr(d, k) for d in good]) for k in ("error", "covariance"))
    sizes, size, mean = _sizes(errors), squared(errors, covariances), errors.mean(0)
    over = sizes / error_metrics.spread(reference)
    of_mean = covariances.mean(0) / len(good)
    return Statistics(
        count=len(good),
        lost=len(draws) - len(good),
        rms=tuple(np.sqrt(np.mean(sizes**2, 0)).tolist()),
        reference=error_metrics.spread(reference),
        bare=error_metrics.spread(bare),
        worst=float(over.max()),
        beyond=float(np.mean(over.max(1) > SINGLE)),
        usual=usual(reference),
        nees=float(size.mean() / 6),
        shift=float(squared(mean[None], of_mean[None])[0] / 6),
        held=float(np.mean(size < chi2.ppf(LEVEL, 6))),
    )


def of_runs(draws):
    """The Statistics of Draws of different recordings; the reference is σ as reported."""
    known = [d.covariance for d in draws if d.covariance is not None]
    mean = np.mean(known, axis=0) if known else np.full((6, 6), np.nan)
    return statistics(draws, mean, mean)


def _sizes(errors):
    """(n, 2): mm, deg of errors (n, 6)."""
    shift, turn = (np.linalg.norm(errors[:, b], axis=1) for b in (np.s_[:3], np.s_[3:]))
    return np.column_stack([1e3 * shift, np.degrees(turn)])


def squared(errors, covariances):
    """Normalised squares (n,) of errors (n, k) by their covariances (n, k, k)."""
    solved = np.linalg.solve(covariances, errors[..., None])[..., 0]
    return np.sum(errors * solved, -1)


def usual(reference):
    """Share of draws above SINGLE times the reference, were they of that covariance (6, 6)."""
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(np.zeros(6), reference, TRIALS, method="cholesky")
    return float(np.mean((_sizes(drawn) / error_metrics.spread(reference)).max(1) > SINGLE))


def band(count, size=6):
    """LEVEL band of the mean over `count` draws of NEES/size, where σ is honest."""
    ends = chi2.ppf([(1 - LEVEL) / 2, (1 + LEVEL) / 2], size * count)
    return tuple((ends / (size * count)).tolist())
