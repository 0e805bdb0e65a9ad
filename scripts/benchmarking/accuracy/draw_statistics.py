"""Statistics of many results of one case: size of the errors, and how well σ predicts them."""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray
from scipy.stats import chi2

from benchmarking.accuracy.accuracy_cases import MAX_SINGLE_RATIO
from benchmarking.accuracy.error_metrics import sigma_mm_deg

CONFIDENCE_LEVEL = 0.95  # of the ellipsoids and of the bands
N_TRIALS = 20_000  # random errors from which the outlier share of an efficient estimator follows


@dataclass(frozen=True)
class DrawResult:
    """Error and covariance of one result.

    error: (k,) twist from the estimate to the truth; covariance: (k, k) as reported. Both are None
    if there is no result.
    """

    error: np.ndarray | None
    covariance: np.ndarray | None


@dataclass(frozen=True)
class DrawStatistics:
    """Statistics of all draws of one case.

    n_results, n_failures: draws with and without a pose; rms_error, reference and
    reference_without_outlines: (mm, deg); worst_error_ratio: largest error of one draw over the
    reference; outlier_share: draws with an error above MAX_SINGLE_RATIO times the reference, in mm
    or deg; gaussian_outlier_share: the same of an efficient estimator; mean_nees: mean of NEES/6;
    mean_error_nees: NEES/6 of the mean error; share_covered: share of the ellipsoids
    (CONFIDENCE_LEVEL) that contain the truth.
    """

    n_results: int
    n_failures: int
    rms_error: tuple[float, float]
    reference: tuple[float, float]
    reference_without_outlines: tuple[float, float]
    worst_error_ratio: float
    outlier_share: float
    gaussian_outlier_share: float
    mean_nees: float
    mean_error_nees: float
    share_covered: float


def compute_draw_statistics(
    draws: list[DrawResult], reference: ndarray, reference_without_outlines: ndarray
) -> DrawStatistics:
    """Compute the statistics of draws, at least one of which has a result.

    reference, reference_without_outlines: covariances (6, 6).
    """
    good = [d for d in draws if d.error is not None]
    errors, covariances = (np.array([getattr(d, k) for d in good]) for k in ("error", "covariance"))
    sizes, mean = _errors_mm_deg(errors), errors.mean(0)
    nees = normalized_squared_errors(errors, covariances)
    ratio = sizes / sigma_mm_deg(reference)
    mean_covariance = covariances.mean(0) / len(good)
    rms_mm, rms_deg = np.sqrt(np.mean(sizes**2, 0)).tolist()
    return DrawStatistics(
        n_results=len(good),
        n_failures=len(draws) - len(good),
        rms_error=(rms_mm, rms_deg),
        reference=sigma_mm_deg(reference),
        reference_without_outlines=sigma_mm_deg(reference_without_outlines),
        worst_error_ratio=float(ratio.max()),
        outlier_share=float(np.mean(ratio.max(1) > MAX_SINGLE_RATIO)),
        gaussian_outlier_share=expected_outlier_share(reference),
        mean_nees=float(nees.mean() / 6),
        mean_error_nees=float(normalized_squared_errors(mean[None], mean_covariance[None])[0] / 6),
        share_covered=float(np.mean(nees < chi2.ppf(CONFIDENCE_LEVEL, 6))),
    )


def compute_run_statistics(draws: list[DrawResult]) -> DrawStatistics:
    """Compute the statistics of different recordings; the reference is the mean reported σ."""
    reported = [d.covariance for d in draws if d.covariance is not None]
    mean = np.mean(reported, axis=0) if reported else np.full((6, 6), np.nan)
    return compute_draw_statistics(draws, mean, mean)


def _errors_mm_deg(errors: ndarray) -> ndarray:
    """Return the errors (n, 2), mm and deg, of twists (n, 6)."""
    shift, turn = (np.linalg.norm(errors[:, b], axis=1) for b in (np.s_[:3], np.s_[3:]))
    return np.column_stack([1e3 * shift, np.degrees(turn)])


def normalized_squared_errors(errors: ndarray, covariances: ndarray) -> ndarray:
    """Return the NEES (n,) of errors (n, k) with covariances (n, k, k)."""
    solved = np.linalg.solve(covariances, errors[..., None])[..., 0]
    return np.sum(errors * solved, -1)


def expected_outlier_share(reference: ndarray) -> float:
    """Return the share of Gaussian errors above MAX_SINGLE_RATIO times the reference.

    reference: covariance (6, 6) of the errors.
    """
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(np.zeros(6), reference, N_TRIALS, method="cholesky")
    return float(
        np.mean((_errors_mm_deg(drawn) / sigma_mm_deg(reference)).max(1) > MAX_SINGLE_RATIO)
    )


def compute_nees_band(n_draws: int, n_dof: int = 6) -> tuple[float, float]:
    """Return the band (CONFIDENCE_LEVEL) of the mean of NEES/n_dof over n_draws if σ is correct."""
    ends = chi2.ppf([(1 - CONFIDENCE_LEVEL) / 2, (1 + CONFIDENCE_LEVEL) / 2], n_dof * n_draws)
    low, high = (ends / (n_dof * n_draws)).tolist()
    return low, high
