"""Noise as the residuals show it: of every kind of measurement by every sensor, and of the MCS.

The configured noise of the MCS is a floor; that of the measurements is where the search starts.
"""

import numpy as np
from scipy.stats import chi2

from calib.estimation.residuals.assignment import Noise
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS, uses_template_points
from calib.geometry.units import MAD_TO_SIGMA

UNIFORM_MEDIAN_OVER_SIGMA = np.sqrt(3) / 2  # of the absolute value over σ, of a uniform error
INITIAL_NOISE_FACTOR = 3.0  # times what the residuals show at a start that may be off
MOVING_VIEW_SUFFIX = " in motion"
MIN_NOISE_RATIO = 0.3  # a noise falls at most to this share in a round, so that members follow


def initial_noise(kind, factor):
    """Noise of a kind to start from: factor times the keypoints' own σ. A step of the scan pattern
    is as large as it is, and all repetitions have it in common."""
    return Noise(factor, 0.0) if RESIDUAL_KINDS[kind].MIN_SIGMA is not None else Noise(0.0, 1.0)


def widen_initial_noise(setup, assignments, min_noise):
    """Noise by (sensor, kind) to start from: `least`, or what takes in all that the geometry admits
    where the start is off, or the model is, by more. Nearest template points shift with the start:
    they are left to the first pass."""
    noise = dict(min_noise)
    for key in min_noise:
        groups = zip(setup.groups, assignments, strict=True)
        values = [a.residual_over_sigma0[a.is_candidate] for g, a in groups if noise_key(g) == key]
        values = np.abs(np.concatenate(values))
        if len(values) and not uses_template_points(key[1]):
            ratio = max(
                1.0,
                INITIAL_NOISE_FACTOR
                * MAD_TO_SIGMA
                * float(np.median(values))
                / min_noise[key].total,
            )
            noise[key] = Noise(*(ratio * part for part in min_noise[key]))
    return noise


def estimate_measurement_noise(setup, assignments, previous_noise):
    """Noise by (sensor, kind) from the residuals of the members, its common share as before."""
    noise = dict(previous_noise)
    for key, found in _inliers_by_noise_key(setup, assignments).items():
        values = np.concatenate([a.residual_over_sigma0[member] for a, member in found])
        own = np.median(np.concatenate([a.keypoint_sigma[member] for a, member in found]))
        ratio = (
            _estimate_total_noise(key[1], values, own, previous_noise[key].total)
            / previous_noise[key].total
        )
        noise[key] = Noise(previous_noise[key].white * ratio, previous_noise[key].common * ratio)
    return noise


def split_common_noise(setup, assignments, noise, leverage):
    """Noise by (sensor, kind), of the same size, with the share in common that the residuals show.

    leverage: by (sensor, kind), how many residuals the estimate has used up. Only of an estimate
    that has arrived: what a pose that is off does to the residuals of a cell looks common to them.
    """
    noise = dict(noise)
    for key, found in _inliers_by_noise_key(setup, assignments).items():
        values = np.concatenate([a.residual_over_sigma0[member] for a, member in found])
        share = common_variance_share(values, _number_repeat_groups(found), leverage[key])
        total = noise[key].total
        noise[key] = Noise(total * np.sqrt(1 - share), total * np.sqrt(share))
    return noise


def noise_key(group):
    """What noise a group of keypoints has: (sensor, kind); views in motion have their own."""
    return group.sensor + (MOVING_VIEW_SUFFIX if group.is_moving else ""), group.kind


def _inliers_by_noise_key(setup, assigned):
    """{(sensor, kind): [(Assignment, which are members)]} of the groups that have any."""
    found = {}
    for g, a in zip(setup.groups, assigned, strict=True):
        if (a.feature >= 0).any():
            found.setdefault(noise_key(g), []).append((a, a.feature >= 0))
    return found


def _number_repeat_groups(found):
    """Cell of every member, numbered through all Assignments."""
    cells, start = [], 0
    for a, member in found:
        cells.append(start + a.repeat_group[member])
        start += a.repeat_group.max() + 1
    return np.unique(np.concatenate(cells), return_inverse=True)[1]


def _estimate_total_noise(kind, values, keypoint_sigma, previous_total):
    """Noise over the keypoints' own σ from residuals (n, k) in units of it.

    The median absolute residual, falling by at most SHRINK a round. Where σ is the step of a scan
    pattern: likewise of a uniform error, but at least the step; a wide beam or a wrong outline adds
    to it. To the nearest template point: the rms, for the few far ones are what still moves it.
    """
    rounding = RESIDUAL_KINDS[kind].MIN_SIGMA
    if rounding is None:
        return max(1.0, float(np.median(np.abs(values))) / UNIFORM_MEDIAN_OVER_SIGMA)
    if uses_template_points(kind):
        found = float(np.sqrt(np.mean(values**2)))
    else:
        found = MAD_TO_SIGMA * float(np.median(np.abs(values)))
    return max(found, MIN_NOISE_RATIO * previous_total, rounding / keypoint_sigma)


def common_variance_share(values, repeat_groups, leverage):
    """Share of the variance of values (n, k) that those of one cell (n,) have in common.

    Analysis of variance about zero: with m of them in a cell, the mean has variance c² + w²/m.
    leverage: how many of the cells' means the estimate has used up.
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


def update_mocap_factor(mocap_errors, determined_share, previous_factor):
    """Factor on the priors of the MCS poses, at least 1, from errors mocap_errors (k, 6) in units of them and
    how well each is determined_share (k, 6), 0 to 1.

    Fixed point of the evidence (MacKay 1992): Σy² over the number of well-determined errors. So few
    of them are large by chance often enough that Σy² is held against what it exceeds in one of a
    hundred cases: the factor departs from 1 only where the stated σ cannot be true.
    """
    determined = np.sum(determined_share)
    if determined < 1:
        return previous_factor
    return max(
        1.0, previous_factor * float(np.sqrt(np.sum(mocap_errors**2) / chi2.ppf(0.99, determined)))
    )
