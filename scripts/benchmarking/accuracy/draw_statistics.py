"""Many results of one case against their truth: how large the errors are, and how honest σ is."""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray
from scipy.stats import chi2

from benchmarking.accuracy.accuracy_cases import MAX_SINGLE_RATIO
from benchmarking.accuracy.error_metrics import sigma_mm_deg

CONFIDENCE_LEVEL = 0.95  # of the ellipsoids and of the bands
N_TRIALS = 20_000  # of the share that an efficient estimator would have above SINGLE


@dataclass(frozen=True)
class DrawResult:
    """The error (k,) of one result, twists from what was found to the truth, and the covariance
    (k, k) that came with it; None, None where there is no result."""

    error: np.ndarray | None
    covariance: np.ndarray | None


@dataclass(frozen=True)
class DrawStatistics:
    """Over the draws of one case. count: with a result; lost: without; rms, reference, bare: (mm,
    deg), bare being the reference without outlines; worst: the largest error of one draw over the
    reference; beyond: the share of draws above SINGLE times the reference, in mm or deg, and
    usual: that of an efficient estimator; nees: mean of NEES/6; shift: its like, of the mean error;
    held: the share of LEVEL ellipsoids that hold the truth."""

    n_results: int
    n_failures: int
    rms_error: tuple
    reference: tuple
    reference_without_outlines: tuple
    worst_error_ratio: float
    outlier_share: float
    gaussian_outlier_share: float
    mean_nees: float
    mean_error_nees: float
    share_covered: float


def compute_draw_statistics(
    draws: list[DrawResult], reference: ndarray, reference_without_outlines: ndarray
) -> DrawStatistics:
    """The Statistics of Draws, of which one at least has a result; reference,
    reference_without_outlines: covariances (6, 6)."""
    good = [d for d in draws if d.error is not None]
    errors, covariances = (np.array([getattr(d, k) for d in good]) for k in ("error", "covariance"))
    sizes, size, mean = (
        _errors_mm_deg(errors),
        normalized_squared_errors(errors, covariances),
        errors.mean(0),
    )
    over = sizes / sigma_mm_deg(reference)
    of_mean = covariances.mean(0) / len(good)
    return DrawStatistics(
        n_results=len(good),
        n_failures=len(draws) - len(good),
        rms_error=tuple(np.sqrt(np.mean(sizes**2, 0)).tolist()),
        reference=sigma_mm_deg(reference),
        reference_without_outlines=sigma_mm_deg(reference_without_outlines),
        worst_error_ratio=float(over.max()),
        outlier_share=float(np.mean(over.max(1) > MAX_SINGLE_RATIO)),
        gaussian_outlier_share=expected_outlier_share(reference),
        mean_nees=float(size.mean() / 6),
        mean_error_nees=float(normalized_squared_errors(mean[None], of_mean[None])[0] / 6),
        share_covered=float(np.mean(size < chi2.ppf(CONFIDENCE_LEVEL, 6))),
    )


def compute_run_statistics(draws: list[DrawResult]) -> DrawStatistics:
    """The Statistics of Draws of different recordings; the reference is σ as reported."""
    known = [d.covariance for d in draws if d.covariance is not None]
    mean = np.mean(known, axis=0) if known else np.full((6, 6), np.nan)
    return compute_draw_statistics(draws, mean, mean)


def _errors_mm_deg(errors: ndarray) -> ndarray:
    """(n, 2): mm, deg of errors (n, 6)."""
    shift, turn = (np.linalg.norm(errors[:, b], axis=1) for b in (np.s_[:3], np.s_[3:]))
    return np.column_stack([1e3 * shift, np.degrees(turn)])


def normalized_squared_errors(errors: ndarray, covariances: ndarray) -> ndarray:
    """Normalised squares (n,) of errors (n, k) by their covariances (n, k, k)."""
    solved = np.linalg.solve(covariances, errors[..., None])[..., 0]
    return np.sum(errors * solved, -1)


def expected_outlier_share(reference: ndarray) -> float:
    """Share of draws above SINGLE times the reference, were they of that covariance (6, 6)."""
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(np.zeros(6), reference, N_TRIALS, method="cholesky")
    return float(
        np.mean((_errors_mm_deg(drawn) / sigma_mm_deg(reference)).max(1) > MAX_SINGLE_RATIO)
    )


def compute_nees_band(n_draws: int, n_dof: int = 6) -> tuple[float, float]:
    """LEVEL band of the mean over `count` draws of NEES/size, where σ is honest."""
    ends = chi2.ppf([(1 - CONFIDENCE_LEVEL) / 2, (1 + CONFIDENCE_LEVEL) / 2], n_dof * n_draws)
    return tuple((ends / (n_dof * n_draws)).tolist())
