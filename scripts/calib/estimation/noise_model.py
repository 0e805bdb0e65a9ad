"""Noise as the residuals show it: of every kind of measurement by every sensor, and of the MCS.

The configured noise of the MCS is a floor; that of the measurements is where the search starts.
"""

import numpy as np
from scipy.stats import chi2

from calib.estimation.residuals import residual_registry
from calib.estimation.residuals.assignment import Noise

MAD_TO_SIGMA = 1.4826
UNIFORM_MEDIAN = np.sqrt(3) / 2  # of the absolute value over σ, of a uniform error
WIDE = 3.0  # times what the residuals show at a start that may be off
IN_MOTION = " in motion"
SHRINK = 0.3  # a noise falls at most to this share in a round, so that members follow


def initial(kind, factor):
    """Noise of a kind to start from: factor times the keypoints' own σ. A step of the scan pattern
    is as large as it is, and all repetitions have it in common."""
    return (
        Noise(factor, 0.0)
        if residual_registry.KINDS[kind].ROUNDING is not None
        else Noise(0.0, 1.0)
    )


def wide(setup, assigned, least):
    """Noise by (sensor, kind) to start from: `least`, or what takes in all that the geometry admits
    where the start is off, or the model is, by more. Nearest template points shift with the start:
    they are left to the first pass."""
    noise = dict(least)
    for key in least:
        groups = zip(setup.groups, assigned, strict=True)
        values = [a.plain[a.candidate] for g, a in groups if of(g) == key]
        values = np.abs(np.concatenate(values))
        if len(values) and not residual_registry.by_nearest_point(key[1]):
            ratio = max(1.0, WIDE * MAD_TO_SIGMA * float(np.median(values)) / least[key].total)
            noise[key] = Noise(*(ratio * part for part in least[key]))
    return noise


def of_measurements(setup, assigned, before):
    """Noise by (sensor, kind) from the residuals of the members, its common share as before."""
    noise = dict(before)
    for key, found in _members(setup, assigned).items():
        values = np.concatenate([a.plain[member] for a, member in found])
        own = np.median(np.concatenate([a.own[member] for a, member in found]))
        ratio = _total(key[1], values, own, before[key].total) / before[key].total
        noise[key] = Noise(before[key].white * ratio, before[key].common * ratio)
    return noise


def shared(setup, assigned, noise, absorbed):
    """Noise by (sensor, kind), of the same size, with the share in common that the residuals show.

    absorbed: by (sensor, kind), how many residuals the estimate has used up. Only of an estimate
    that has arrived: what a pose that is off does to the residuals of a cell looks common to them.
    """
    noise = dict(noise)
    for key, found in _members(setup, assigned).items():
        values = np.concatenate([a.plain[member] for a, member in found])
        share = common_share(values, _cells(found), absorbed[key])
        total = noise[key].total
        noise[key] = Noise(total * np.sqrt(1 - share), total * np.sqrt(share))
    return noise


def of(group):
    """What noise a group of keypoints has: (sensor, kind); views in motion have their own."""
    return group.sensor + (IN_MOTION if group.moving else ""), group.kind


def _members(setup, assigned):
    """{(sensor, kind): [(Assignment, which are members)]} of the groups that have any."""
    found = {}
    for g, a in zip(setup.groups, assigned, strict=True):
        if (a.feature >= 0).any():
            found.setdefault(of(g), []).append((a, a.feature >= 0))
    return found


def _cells(found):
    """Cell of every member, numbered through all Assignments."""
    cells, start = [], 0
    for a, member in found:
        cells.append(start + a.cell[member])
        start += a.cell.max() + 1
    return np.unique(np.concatenate(cells), return_inverse=True)[1]


def _total(kind, values, own, before):
    """Noise over the keypoints' own σ from residuals (n, k) in units of it.

    The median absolute residual, falling by at most SHRINK a round. Where σ is the step of a scan
    pattern: likewise of a uniform error, but at least the step; a wide beam or a wrong outline adds
    to it. To the nearest template point: the rms, for the few far ones are what still moves it.
    """
    rounding = residual_registry.KINDS[kind].ROUNDING
    if rounding is None:
        return max(1.0, float(np.median(np.abs(values))) / UNIFORM_MEDIAN)
    if residual_registry.by_nearest_point(kind):
        found = float(np.sqrt(np.mean(values**2)))
    else:
        found = MAD_TO_SIGMA * float(np.median(np.abs(values)))
    return max(found, SHRINK * before, rounding / own)


def common_share(values, cells, absorbed):
    """Share of the variance of values (n, k) that those of one cell (n,) have in common.

    Analysis of variance about zero: with m of them in a cell, the mean has variance c² + w²/m.
    absorbed: how many of the cells' means the estimate has used up.
    """
    count = np.bincount(cells)
    n, k = values.shape
    if n == len(count):
        return 0.0
    means = np.stack([np.bincount(cells, v) / count for v in values.T], 1)
    free = max(k * len(count) - absorbed, k * len(count) / 4)
    between = np.sum(count[:, None] * means**2) / free
    within = np.sum((values - means[cells]) ** 2) / (k * (n - len(count)))
    common = max(0.0, (between - within) * len(count) / n)
    return float(common / max(common + within, 1e-300))


def of_mocap(y, known, before):
    """Factor on the priors of the MCS poses, at least 1, from errors y (k, 6) in units of them and
    how well each is known (k, 6), 0 to 1.

    Fixed point of the evidence (MacKay 1992): Σy² over the number of well-determined errors. So few
    of them are large by chance often enough that Σy² is held against what it exceeds in one of a
    hundred cases: the factor departs from 1 only where the stated σ cannot be true.
    """
    determined = np.sum(known)
    if determined < 1:
        return before
    return max(1.0, before * float(np.sqrt(np.sum(y**2) / chi2.ppf(0.99, determined))))
