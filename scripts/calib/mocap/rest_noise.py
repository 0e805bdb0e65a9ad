"""Noise of motion capture, white and slow, from the poses of a body at rest.

Means over blocks of a rest differ by white noise, which averages out, and by slow noise, which does
not. They are compared with the covariance that white noise and a first-order Gauss-Markov process
give them, per axis of the body. The mean over the whole rest tells nothing: the pose is unknown.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import null_space

from calib.geometry.se3 import mean_pose
from calib.geometry.units import NS_PER_S
from calib.io.parquet_tables import Columns
from calib.io.pose_block import pose_sigma_from_config
from calib.mocap.body_trajectory import Trajectory, trajectory_from_columns
from calib.mocap.stillness import StillnessLimits, find_still_intervals

# Length of a block, s, at least; longer where a rest has too many, one pose where poses are rare.
BLOCK_S, MAX_BLOCKS = 0.04, 64
MIN_BLOCK_SHARE = 0.5  # of its samples, that a block must have where poses were lost
ROUNDING = 1e-3  # of a block
MIN_REST_BLOCKS = 3  # of a rest that is used
MIN_BLOCKS = 8  # of all rests together, beyond one of each, for an estimate
# Slow noise is taken in only where white noise is this unlikely: log of the likelihood ratio,
# χ² of two degrees of freedom at 99.99 %.
MIN_LOG_RATIO = 9.2
# Rests tell how fast slow noise grows, and its size if they are longer than its time constant.
# Longer time constants than this, in lengths of the longest rest, are not considered.
MAX_TIME_CONSTANT_RESTS = 10.0
N_TIME_CONSTANTS, N_VARIANCE_RATIOS = 24, 40
VARIANCE_RATIOS = (1e-3, 1e5)  # slow over white, the grid
MAX_STATED_RATIO = 1.5  # of measured slow noise to the stated bias, above which it is named
MIN_VARIANCE = 1e-24  # m², rad²: of poses without noise


class RestBlocks(NamedTuple):
    """Means (k, 6) over the blocks of one rest: their numbers (k,), samples (k,) and length, s."""

    number: np.ndarray
    mean: np.ndarray
    samples: np.ndarray
    length_s: float


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

    def speed_sigma(self, window_s: float) -> np.ndarray:
        """Return the σ (6,), per s, of the slope over a window that noise alone makes."""
        n = max(3, round(window_s / self.period_s))
        s = (np.arange(n) - (n - 1) / 2) * self.period_s
        weight = s / (s @ s)
        kept = np.exp(-np.abs(s[:, None] - s) / self.time_constant_s[:, None, None])
        return np.sqrt(self.white**2 * (weight @ weight) + self.slow**2 * (weight @ kept @ weight))

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
    blocks = [found for s, xi in rests if (found := _average_blocks(s, xi, period_s)) is not None]
    if sum(len(found.number) - 1 for found in blocks) < MIN_BLOCKS:
        return None
    duration_s = np.diff(rests_ns, axis=1)[:, 0] / NS_PER_S
    noise = _fit_noise(blocks, duration_s)
    return RestNoise(*noise, period_s, float(duration_s.sum()), float(duration_s.max()))


def _average_blocks(s: np.ndarray, deviations: np.ndarray, period_s: float) -> RestBlocks | None:
    """Return the blocks of a rest: times (n,), s, and deviations (n, 6); None if too few."""
    if len(s) == 0:
        return None
    length_s = max(BLOCK_S, period_s, (s[-1] + period_s) / MAX_BLOCKS)
    block = np.floor((s - s[0]) / length_s + ROUNDING).astype(int)
    samples = np.bincount(block).astype(float)
    sums = np.stack([np.bincount(block, v) for v in deviations.T], 1)
    number = np.flatnonzero(samples >= MIN_BLOCK_SHARE * length_s / period_s)
    if len(number) < MIN_REST_BLOCKS:
        return None
    return RestBlocks(number, sums[number] / samples[number, None], samples[number], length_s)


def _fit_noise(
    blocks: list[RestBlocks], duration_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return σ (6,) of white noise, σ (6,) of slow noise and its time constant (6,), s.

    The likelihood is taken on a grid of time constants and of ratios of slow to white noise. The
    axes share the time constant. Rests shorter than it leave it open: what slow noise leaves in the
    mean of a rest is averaged over the grid. duration_s: (k,) of the rests.
    """
    last_s = MAX_TIME_CONSTANT_RESTS * float(duration_s.max())
    first_s = min(min(found.length_s for found in blocks), last_s / 2)
    tau = np.geomspace(first_s, last_s, N_TIME_CONSTANTS)
    ratio = np.append(0.0, np.geomspace(*VARIANCE_RATIOS, N_VARIANCE_RATIOS))
    white, log_likelihood = _axis_likelihoods(blocks, tau, ratio)
    evidence = log_likelihood.max((1, 2)) - log_likelihood[:, 0, 0]
    if evidence.max() < MIN_LOG_RATIO:
        return np.sqrt(white[:, 0, 0]), np.zeros(6), np.full(6, duration_s.max())
    weight = np.exp(log_likelihood - log_likelihood.max(2, keepdims=True))
    by_time = (log_likelihood.max(2) + np.log(weight.sum(2))).sum(0)
    probability = np.exp(by_time - by_time.max())
    probability /= probability.sum()
    weight *= (probability / weight.sum(2))[..., None]
    time_constant_s = float(np.exp(probability @ np.log(tau)))
    usual_s = float(np.median(duration_s))
    share = mean_variance_share(usual_s, tau) / mean_variance_share(usual_s, time_constant_s)
    slow = (weight * white * ratio * share[:, None]).sum((1, 2))
    return np.sqrt((weight * white).sum((1, 2))), np.sqrt(slow), np.full(6, time_constant_s)


def _axis_likelihoods(
    blocks: list[RestBlocks], tau: np.ndarray, ratio: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return variance of white noise and log likelihood (6, t, r) at time constants and ratios.

    The mean of each rest is unknown. White noise is the one that fits each ratio best.
    """
    square, log_det, n = np.zeros((6, len(tau), len(ratio))), np.zeros((len(tau), len(ratio))), 0
    for found in blocks:
        eigenvalues, amplitudes = _slow_noise_modes(found, tau)
        variance = 1 + ratio[:, None] * eigenvalues[:, None]
        square += np.einsum("tna,trn->atr", amplitudes**2, 1 / variance)
        log_det += np.log(variance).sum(-1)
        n += eigenvalues.shape[1]
    white = np.maximum(square / n, MIN_VARIANCE)
    log_likelihood = -(n * np.log(white) + log_det) / 2
    constant = (square / n <= MIN_VARIANCE).all((1, 2))
    log_likelihood[constant], white[constant] = 0.0, 0.0
    return white, log_likelihood


def _slow_noise_modes(blocks: RestBlocks, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the modes of slow noise of variance 1 in the blocks of a rest, by time constant (t,).

    Their variances (t, m) over that of white noise of variance 1, and amplitudes (t, m, 6).
    """
    root = np.sqrt(blocks.samples)
    contrasts = null_space(root[None]).T * root
    distance_s = np.abs(blocks.number[:, None] - blocks.number) * blocks.length_s
    later_s, time_s = np.maximum(distance_s, blocks.length_s), tau[:, None, None]
    correlation = mean_correlation(later_s, blocks.length_s, time_s)
    correlation = np.where(distance_s > 0, correlation, 1.0)
    slow = mean_variance_share(blocks.length_s, time_s) * correlation
    values, vectors = np.linalg.eigh(contrasts @ slow @ contrasts.T)
    amplitudes = np.swapaxes(vectors, 1, 2) @ (contrasts @ blocks.mean)
    return np.maximum(values, 0.0), amplitudes


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
