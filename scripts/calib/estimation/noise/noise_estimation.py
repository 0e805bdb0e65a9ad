"""Estimate the noise of every kind of measurement and of the motion capture from the residuals."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from calib.estimation.estimate_state import State
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import SolveResult
from calib.estimation.nlp.information_matrix import invert_information
from calib.estimation.noise import noise_model
from calib.estimation.noise.noise_model import MAD_TO_SIGMA, NoiseKey, noise_key
from calib.estimation.residuals.assignment import Assignment, Noise
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS, uses_template_points
from calib.estimation.round_solution import RoundSolution

UNIFORM_MEDIAN_OVER_SIGMA = np.sqrt(3) / 2  # median absolute value over σ of a uniform error
MIN_NOISE_RATIO = 0.3  # least factor on a noise in one round, so that inliers can follow
MOCAP_TEST_LEVEL = 0.99  # of the test that motion capture errors exceed their stated σ


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


def _inliers_by_noise_key(
    setup: Setup, assignments: Sequence[Assignment]
) -> dict[NoiseKey, list[tuple[Assignment, np.ndarray]]]:
    """Return the Assignments that have inliers, each with a mask (n,) of them."""
    out: dict[NoiseKey, list[tuple[Assignment, np.ndarray]]] = {}
    for g, a in zip(setup.groups, assignments, strict=True):
        if (a.feature >= 0).any():
            out.setdefault(noise_model.noise_key(g), []).append((a, a.feature >= 0))
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


def update_noise(setup: Setup, solution: RoundSolution, assignments: Sequence[Assignment]) -> State:
    """Return the State after a solution with the noise that the residuals show.

    assignments: at that State. The common part of the noise is split off once the sensors move by
    less than their σ.
    """
    state, posterior = solution.state, invert_information(solution.solve_result.information)
    noise = estimate_measurement_noise(setup, assignments, state.noise)
    twists = solution.sensor_twists.reshape(-1)
    if np.all(twists**2 < np.diag(posterior)[: twists.size]):
        leverage = residual_leverage(setup, solution.solve_result, posterior)
        noise = split_common_noise(setup, assignments, noise, leverage)
    mocap_factor = estimate_mocap_factor(setup, state, posterior)
    return replace(
        state,
        mocap_errors=state.mocap_errors * state.mocap_noise_factor / mocap_factor,
        noise=noise,
        mocap_noise_factor=mocap_factor,
    )


def residual_leverage(
    setup: Setup, solve_result: SolveResult, posterior_covariance: np.ndarray
) -> dict[NoiseKey, float]:
    """Return the leverage of all residuals of each noise: how many the estimate uses up."""
    leverage: dict[NoiseKey, float] = {}
    for g, factor in zip(setup.groups, solve_result.factors, strict=True):
        covariance = posterior_covariance[np.ix_(factor.columns, factor.columns)]
        part = float(np.sum(factor.hessian_x * covariance))
        leverage[noise_key(g)] = leverage.get(noise_key(g), 0.0) + part
    return leverage


def estimate_mocap_factor(setup: Setup, state: State, posterior_covariance: np.ndarray) -> float:
    """Return the factor on the σ of the motion capture poses; see update_mocap_factor."""
    counts = counted_mocap_errors(setup)
    determined_share = mocap_determined_share(setup, posterior_covariance)
    return update_mocap_factor(
        state.mocap_errors[counts], determined_share[counts], state.mocap_noise_factor
    )


def counted_mocap_errors(setup: Setup) -> np.ndarray:
    """Return which motion capture errors (n,) tell their noise.

    Targets compared with template points do not count: errors by the spacing of a template, common
    to a whole placement, would pass for errors of the motion capture.
    """
    still = setup.placements[: setup.n_still]
    is_exact = np.array([setup.targets[p.target].uses_exact_surface for p in still], bool)
    robots, bodies = (
        index[: setup.n_still] for index in (setup.robot_error_index, setup.body_error_index)
    )
    counts = np.zeros(len(setup.mocap_sigma), bool)
    counts[robots] = counts[bodies] = True
    counts[robots[~is_exact]] = counts[bodies[~is_exact]] = False
    return counts


def mocap_determined_share(setup: Setup, posterior_covariance: np.ndarray) -> np.ndarray:
    """Return how well (n, 6), from 0 to 1, the data determine each motion capture error."""
    variances = np.diag(posterior_covariance)[setup.n_pose_unknowns : setup.n_chain_unknowns]
    return 1 - variances.reshape(-1, 6)


def mocap_scatter(
    setup: Setup, state: State, posterior_covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the σ that the motion capture states and the one its errors show: (m, rad) each.

    None if the data determine too few errors. Both are rms over axes and placements.
    """
    counts = counted_mocap_errors(setup)
    share = np.clip(mocap_determined_share(setup, posterior_covariance)[counts], 0, 1)
    share = np.stack([share[:, :3].sum(), share[:, 3:].sum()])
    if np.any(share < 1):
        return None
    stated = setup.mocap_sigma[counts]
    errors = state.mocap_errors[counts] * state.mocap_noise_factor * stated
    shown = np.sqrt([np.sum(part**2) for part in np.split(errors, 2, 1)] / share)
    return np.sqrt([np.mean(part**2) for part in np.split(stated, 2, 1)]), shown
