"""Noise of motion capture, white and slow, from the poses of a body at rest.

Means over neighbouring blocks of a rest differ by white noise, which averages out, and by slow
noise, which does not. Their differences at doubling block lengths (Allan variances) are compared
with those of white noise and a first-order Gauss-Markov process, per axis of the body.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from calib.geometry.se3 import mean_pose
from calib.geometry.units import NS_PER_S
from calib.io.parquet_tables import Columns
from calib.io.pose_block import pose_sigma_from_config
from calib.mocap.body_trajectory import Trajectory, trajectory_from_columns
from calib.mocap.stillness import StillnessLimits, find_still_intervals

FIRST_BLOCK_SAMPLES = 4  # in the shortest blocks
MIN_BLOCK_SHARE = 0.5  # of its samples, that a block must have where poses were lost
MIN_BLOCK_PAIRS = 8  # of all lengths together, for an estimate
# Slow noise is taken in only where white noise is this unlikely: log of the likelihood ratio,
# χ² of two degrees of freedom at 99.99 %.
MIN_LOG_RATIO = 9.2
# Rests tell how fast slow noise grows, and its size if they are longer than its time constant.
# Longer time constants than this, in lengths of the longest rest, are not considered.
MAX_TIME_CONSTANT_RESTS = 10.0
N_TIME_CONSTANTS, N_VARIANCE_RATIOS = 24, 80
VARIANCE_RATIOS = (1e-4, 1e6)  # slow over white, the grid
MAX_STATED_RATIO = 1.5  # of measured slow noise to the stated bias, above which it is named
MIN_VARIANCE = 1e-24  # m², rad²: of poses without noise


class BlockDifferences(NamedTuple):
    """Allan variances (k, 6) at block lengths (k,), s; samples per block, number of pairs (k,)."""

    variance: np.ndarray
    length_s: np.ndarray
    samples: np.ndarray
    pairs: np.ndarray


@dataclass(frozen=True)
class RestNoise:
    """Noise (6,) of the poses of one body, m and rad, along its axes.

    white: σ of one pose; slow: σ of a Gauss-Markov process, 0 where none is seen; time_constant_s:
    of it; period_s: between poses; rest_s: time at rest that it was measured in; longest_rest_s: of
    the rests.
    """

    white: np.ndarray
    slow: np.ndarray
    time_constant_s: np.ndarray
    period_s: float
    rest_s: float
    longest_rest_s: float

    def slow_mean_sigma(self, duration_s: float) -> np.ndarray:
        """Return the σ (6,) that slow noise leaves in the mean of a rest."""
        return self.slow * np.sqrt(mean_variance_share(duration_s, self.time_constant_s))

    def mean_sigma(self, duration_s: float) -> np.ndarray:
        """Return the σ (6,) of the mean of a rest."""
        white = self.white * np.sqrt(min(1.0, self.period_s / duration_s))
        return np.hypot(white, self.slow_mean_sigma(duration_s))

    def to_dict(self) -> dict[str, Any]:
        """Return the values as JSON, with the σ of a mean over one second."""
        values = asdict(self) | {"mean_1s": self.mean_sigma(1.0)}
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()}


def mean_variance_share(
    duration_s: float | np.ndarray, time_constant_s: float | np.ndarray
) -> np.ndarray:
    """Return the variance of the mean of a Gauss-Markov process over that of the process."""
    x = np.asarray(duration_s) / time_constant_s
    return np.where(x > 1e-4, 2 / x * (1 + np.expm1(-x) / np.maximum(x, 1e-9)), 1 - x / 3)


def mean_correlation(
    centre_distance_s: float | np.ndarray,
    duration_s: float | np.ndarray,
    time_constant_s: float | np.ndarray,
) -> np.ndarray:
    """Return the correlation of the means of a Gauss-Markov process over two intervals.

    Both last duration_s; their centres are further apart than that.
    """
    x = duration_s / time_constant_s
    spread = np.expm1(-x) ** 2 * np.exp(-(centre_distance_s / time_constant_s - x)) / x**2
    return spread / mean_variance_share(duration_s, time_constant_s)


def measure_rest_noise(trajectory: Trajectory, rests_ns: np.ndarray) -> RestNoise | None:
    """Return the noise of a body that rests in the intervals (k, 2), ns; None if these are few."""
    t = trajectory.stamps_ns
    if len(t) < 2 or len(rests_ns) == 0:
        return None
    period_s = float(np.median(np.diff(t))) / NS_PER_S
    rests = []
    for start, end in rests_ns:
        rows = (t >= start) & (t <= end)
        rests.append(((t[rows] - start) / NS_PER_S, mean_pose(trajectory.poses[rows])[1]))
    differences = _difference_blocks(rests, period_s)
    if differences.pairs.sum() < MIN_BLOCK_PAIRS:
        return None
    longest_s = float((rests_ns[:, 1] - rests_ns[:, 0]).max() / NS_PER_S)
    rest_s = float((rests_ns[:, 1] - rests_ns[:, 0]).sum() / NS_PER_S)
    return RestNoise(*_fit_noise(differences, longest_s), period_s, rest_s, longest_s)


def _difference_blocks(
    rests: list[tuple[np.ndarray, np.ndarray]], period_s: float
) -> BlockDifferences:
    """Return the Allan variances of rests: times (n,), s, and deviations (n, 6) from their mean."""
    length_s, rows = FIRST_BLOCK_SAMPLES * period_s, []
    longest_s = max((s[-1] for s, _ in rests if len(s)), default=0.0)
    while 2 * length_s <= longest_s + period_s:
        least = MIN_BLOCK_SHARE * length_s / period_s
        found = [_paired_blocks(s, xi, length_s, least) for s, xi in rests]
        squares = np.concatenate([d for d, _ in found]) ** 2 / 2
        counts = np.concatenate([c for _, c in found])
        if len(squares):
            rows.append((squares.mean(0), length_s, 1 / (1 / counts).mean(), len(squares)))
        length_s *= 2
    if not rows:
        return BlockDifferences(np.zeros((0, 6)), np.zeros(0), np.zeros(0), np.zeros(0))
    return BlockDifferences(*(np.array(column) for column in zip(*rows, strict=True)))


def _paired_blocks(
    s: np.ndarray, deviations: np.ndarray, length_s: float, min_samples: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return differences (p, 6) of neighbouring blocks, and their samples (p,) per block."""
    block = np.floor(s / length_s).astype(int)
    n_pairs = (block.max(initial=-1) + 1) // 2
    count = np.bincount(block, minlength=2 * n_pairs + 1).astype(float)
    sums = np.stack([np.bincount(block, v, len(count)) for v in deviations.T], 1)
    means = sums / np.maximum(count, 1)[:, None]
    first, second = (slice(k, 2 * n_pairs, 2) for k in (0, 1))
    full = np.minimum(count[first], count[second]) >= min_samples
    samples = 2 / (1 / np.maximum(count[first], 1) + 1 / np.maximum(count[second], 1))
    return (means[second] - means[first])[full], samples[full]


def _fit_noise(d: BlockDifferences, longest_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return σ (6,) of white noise, σ (6,) of slow noise and its time constant (6,), s.

    The likelihood of all variances is taken on a grid of time constants and of ratios of slow to
    white noise. The axes share the time constant. Rests shorter than it leave it open: variances
    are averaged over the grid, and the time constant is the one that keeps the rate at which slow
    noise grows.
    """
    last_s = MAX_TIME_CONSTANT_RESTS * longest_s
    tau = np.geomspace(min(d.length_s[0], last_s / 2), last_s, N_TIME_CONSTANTS)
    ratio = np.append(0.0, np.geomspace(*VARIANCE_RATIOS, N_VARIANCE_RATIOS))
    white, log_likelihood = _axis_likelihoods(d, tau, ratio)
    evidence = log_likelihood.max((1, 2)) - log_likelihood[:, 0, 0]
    if evidence.max() < MIN_LOG_RATIO:
        return np.sqrt(white[:, 0, 0]), np.zeros(6), np.full(6, longest_s)
    largest = log_likelihood.max(2, keepdims=True)
    weight = np.exp(log_likelihood - largest)
    by_time = (largest[..., 0] + np.log(weight.sum(2))).sum(0)
    weight *= (np.exp(by_time - by_time.max()) / weight.sum(2))[..., None]
    weight /= weight.sum((1, 2), keepdims=True)
    slow = white * ratio
    slow_variance = (weight * slow).sum((1, 2))
    rate = (weight * slow / tau[:, None]).sum((1, 2))
    time_constant_s = np.where(rate > 0, slow_variance / np.where(rate > 0, rate, 1.0), longest_s)
    return np.sqrt((weight * white).sum((1, 2))), np.sqrt(slow_variance), time_constant_s


def _axis_likelihoods(
    d: BlockDifferences, tau: np.ndarray, ratio: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return variance of white noise and log likelihood (6, t, r) at time constants and ratios."""
    x = d.length_s / tau[:, None]
    slow_shape = mean_variance_share(d.length_s, tau[:, None]) - (np.expm1(-x) / x) ** 2
    shape = 1 / d.samples + ratio[:, None] * slow_shape[:, None]
    white = (d.pairs * np.maximum(d.variance.T, MIN_VARIANCE)[:, None, None] / shape).sum(-1)
    white /= d.pairs.sum()
    log_likelihood = -(d.pairs * np.log(white[..., None] * shape)).sum(-1) / 2
    constant = (d.variance <= MIN_VARIANCE).all(0)
    log_likelihood[constant], white[constant] = 0.0, 0.0
    return white, log_likelihood


def measure_body_noise(
    mocap_columns: Columns, bodies: Iterable[str], limits: StillnessLimits, max_gap_s: float
) -> dict[str, RestNoise]:
    """Return the noise of the bodies that rest in the map, by name; columns of mocap.parquet."""
    out = {}
    for name in sorted(set(bodies)):
        trajectory = trajectory_from_columns(mocap_columns, name, max_gap_s)
        noise = measure_rest_noise(trajectory, find_still_intervals(trajectory, limits))
        if noise is not None:
            out[name] = noise
    return out


def slow_noise_columns(noise: RestNoise | None, name: str, duration_s: float) -> dict[str, Any]:
    """Return the columns of placements.parquet on the slow noise of a body over a rest.

    name: robot or body; noise: None where there is none, or where it is not used.
    """
    sigma = np.zeros(6) if noise is None else noise.slow_mean_sigma(duration_s)
    time_s = np.zeros(6) if noise is None else noise.time_constant_s
    return {f"{name}_slow_sigma": sigma, f"{name}_slow_time_s": time_s}


def describe_rest_noise(name: str, noise: RestNoise, mocap_options: dict[str, Any]) -> str:
    """Return in words how the poses of a body scatter at rest, and a stated σ that is too small.

    mocap_options: block `mocap` of the rig.
    """
    scatter = format_sigma(noise.mean_sigma(1.0))
    text = f"{name}: motion capture scatters by {scatter} over a second at rest"
    if not noise.slow.any():
        return f"{text}; white noise"
    slow = noise.slow_mean_sigma(1.0)
    text += f"; slow noise, which does not average out, {format_sigma(slow)}"
    stated = pose_sigma_from_config(mocap_options["pose_bias_sigma"])
    if mocap_options["use_measured_noise"] or (slow <= MAX_STATED_RATIO * stated).all():
        return text
    block = f"{{xyz_m: {slow[:3].max():.2g}, rpy_deg: {np.degrees(slow[3:].max()):.2g}}}"
    return (
        f"{text}; more than the stated mocap.pose_bias_sigma, {format_sigma(stated)}. Set it to "
        f"{block}, or leave it out"
    )


def format_sigma(sigma: np.ndarray) -> str:
    """Format the largest σ (6,) of position and rotation."""
    return f"{1e3 * sigma[:3].max():.2g} mm, {np.degrees(sigma[3:].max()):.2g}°"
