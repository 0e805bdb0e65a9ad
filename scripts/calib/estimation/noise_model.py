"""Noise as the residuals show it: per kind of measurement and sensor, and of the motion capture.

The configured noise of the motion capture is a lower bound; that of the measurements is where the
estimation starts.
"""

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.residuals.assignment import Assignment, Noise
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS, uses_template_points

NoiseKey = tuple[str, str]  # sensor (of moving views with a suffix), kind

MAD_TO_SIGMA = 1.4826
UNIFORM_MEDIAN_OVER_SIGMA = np.sqrt(3) / 2  # median absolute value over σ of a uniform error
INITIAL_NOISE_FACTOR = 3.0  # on what the residuals show at a start that may be wrong
MOVING_VIEW_SUFFIX = " in motion"
MIN_NOISE_RATIO = 0.3  # least factor on a noise in one round, so that inliers can follow
MOCAP_TEST_LEVEL = 0.99  # of the test that motion capture errors exceed their stated σ


def initial_noise(kind: str, factor: float) -> Noise:
    """Return the noise of a kind to start from: factor times the σ of the keypoints.

    Where σ is the step of a scan pattern, it is not scaled, and is common to all repetitions.
    """
    return Noise(factor, 0.0) if RESIDUAL_KINDS[kind].MIN_SIGMA is not None else Noise(0.0, 1.0)


def widen_initial_noise(
    setup: Setup, assignments: Sequence[Assignment], min_noise: dict[NoiseKey, Noise]
) -> dict[NoiseKey, Noise]:
    """Widen noise (min_noise) to what the residuals of all candidates show at a wrong start.

    Nearest template points shift with the start: their noise is left to the first round.
    """
    noise = dict(min_noise)
    for key in min_noise:
        groups = zip(setup.groups, assignments, strict=True)
        values = [a.residual_over_sigma0[a.is_candidate] for g, a in groups if noise_key(g) == key]
        residuals = np.abs(np.concatenate(values))
        if len(residuals) and not uses_template_points(key[1]):
            shown = INITIAL_NOISE_FACTOR * MAD_TO_SIGMA * float(np.median(residuals))
            ratio = max(1.0, shown / min_noise[key].total)
            noise[key] = Noise(*(ratio * part for part in min_noise[key]))
    return noise


def estimate_measurement_noise(
    setup: Setup, assignments: Sequence[Assignment], previous_noise: dict[NoiseKey, Noise]
) -> dict[NoiseKey, Noise]:
    """Estimate every noise from the residuals of its inliers; its common share stays."""
    noise = dict(previous_noise)
    for key, group in _inliers_by_noise_key(setup, assignments).items():
        values = np.concatenate([a.residual_over_sigma0[is_inlier] for a, is_inlier in group])
        sigma = np.median(np.concatenate([a.keypoint_sigma[is_inlier] for a, is_inlier in group]))
        previous = previous_noise[key]
        ratio = _estimate_total_noise(key[1], values, sigma, previous.total) / previous.total
        noise[key] = Noise(previous.white * ratio, previous.common * ratio)
    return noise


def split_common_noise(
    setup: Setup,
    assignments: Sequence[Assignment],
    noise: dict[NoiseKey, Noise],
    leverage: dict[NoiseKey, float],
) -> dict[NoiseKey, Noise]:
    """Split every noise into white and common parts as the residuals show; its size stays.

    leverage: how many residuals the estimate uses up. Call it only with poses near the solution: a
    wrong pose shifts all residuals of a repeat group alike, which looks like common noise.
    """
    noise = dict(noise)
    for key, group in _inliers_by_noise_key(setup, assignments).items():
        values = np.concatenate([a.residual_over_sigma0[is_inlier] for a, is_inlier in group])
        share = common_variance_share(values, _number_repeat_groups(group), leverage[key])
        total = noise[key].total
        noise[key] = Noise(total * np.sqrt(1 - share), total * np.sqrt(share))
    return noise


def noise_key(group: MeasurementGroup) -> NoiseKey:
    """Return the key of a group's noise; moving views have their own."""
    return group.sensor + (MOVING_VIEW_SUFFIX if group.is_moving else ""), group.kind


def _inliers_by_noise_key(
    setup: Setup, assignments: Sequence[Assignment]
) -> dict[NoiseKey, list[tuple[Assignment, np.ndarray]]]:
    """Return the Assignments that have inliers, each with a mask (n,) of them."""
    out: dict[NoiseKey, list[tuple[Assignment, np.ndarray]]] = {}
    for g, a in zip(setup.groups, assignments, strict=True):
        if (a.feature >= 0).any():
            out.setdefault(noise_key(g), []).append((a, a.feature >= 0))
    return out


def _number_repeat_groups(group: list[tuple[Assignment, np.ndarray]]) -> np.ndarray:
    """Number the repeat group of every inlier through all Assignments."""
    numbers, start = [], 0
    for a, is_inlier in group:
        numbers.append(start + a.repeat_group[is_inlier])
        start += a.repeat_group.max() + 1
    return np.unique(np.concatenate(numbers), return_inverse=True)[1]


def _estimate_total_noise(
    kind: str, values: np.ndarray, keypoint_sigma: float, previous_total: float
) -> float:
    """Estimate noise in units of the keypoints' σ, from residuals (n, k) in the same units.

    From the median absolute residual, reduced at most by MIN_NOISE_RATIO per round. Where σ is the
    step of a scan pattern: the median of a uniform error, and at least the step, as a wide beam or
    a wrong outline add to it. For nearest template points: the rms, as the few far ones are what
    still moves the estimate.
    """
    min_sigma = RESIDUAL_KINDS[kind].MIN_SIGMA
    if min_sigma is None:
        return max(1.0, float(np.median(np.abs(values))) / UNIFORM_MEDIAN_OVER_SIGMA)
    if uses_template_points(kind):
        shown = float(np.sqrt(np.mean(values**2)))
    else:
        shown = MAD_TO_SIGMA * float(np.median(np.abs(values)))
    return max(shown, MIN_NOISE_RATIO * previous_total, min_sigma / keypoint_sigma)


def common_variance_share(values: np.ndarray, repeat_groups: np.ndarray, leverage: float) -> float:
    """Return the share of the variance of values (n, k) that their repeat groups (n,) share.

    Analysis of variance about zero: the mean of m values with common σ c and white σ w has variance
    c² + w²/m. leverage: how many of the means the estimate uses up.
    """
    count = np.bincount(repeat_groups)
    n, k = values.shape
    if n == len(count):
        return 0.0
    means = np.stack([np.bincount(repeat_groups, v) / count for v in values.T], 1)
    free = max(k * len(count) - leverage, k * len(count) / 4)
    between = np.sum(count[:, None] * means**2) / free
    within = np.sum((values - means[repeat_groups]) ** 2) / (k * (n - len(count)))
    common = max(0.0, (between - within) * len(count) / n)
    return float(common / max(common + within, 1e-300))


def update_mocap_factor(
    mocap_errors: np.ndarray, determined_share: np.ndarray, previous_factor: float
) -> float:
    """Return the factor, at least 1, on the σ of the motion capture poses.

    mocap_errors: (k, 6) in units of σ times previous_factor; determined_share: (k, 6), from 0 to 1,
    how well the data determine each.

    Fixed point of the evidence (MacKay 1992): Σy² over the number of determined errors. As few of
    them are often large by chance, Σy² is compared with its 99 % quantile: the factor exceeds 1
    only if the stated σ cannot be true.
    """
    n_determined = np.sum(determined_share)
    if n_determined < 1:
        return previous_factor
    expected = chi2.ppf(MOCAP_TEST_LEVEL, n_determined)
    return max(1.0, previous_factor * float(np.sqrt(np.sum(mocap_errors**2) / expected)))
