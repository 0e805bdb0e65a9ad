"""Simulate the errors of motion capture: noise, bias, dropouts and swapped labels."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from calib.geometry.se3 import invert_pose, se3_exp
from calib.geometry.units import NS_PER_S
from simulation.world.smooth_motion import interpolate_placement_values

MCS_PERIOD_NS = 10_000_000  # at the default rate
MEAN_DROPOUT_SAMPLES = 8  # samples lost in a row, on average
LABEL_SWAP_DURATION_NS = (100_000_000, 300_000_000)  # shortest and longest


class LabelSwap(NamedTuple):
    """An interval, ns, in which two bodies have each other's name."""

    start_ns: int
    end_ns: int
    bodies: tuple[str, str]


class MarkerKnock(NamedTuple):
    """The robot's markers sit elsewhere from a time, ns, on, by T (4, 4) in the frame before."""

    start_ns: int
    T_before_after: np.ndarray

    @classmethod
    def after_share(
        cls, placement_times_ns: np.ndarray, share: float, T_before_after: np.ndarray
    ) -> "MarkerKnock":
        """Return a knock during the move that follows a share of the placements (n, 2)."""
        n = len(placement_times_ns)
        first = int(np.clip(round(share * n), 1, n - 1))
        start_ns = (placement_times_ns[first - 1, 1] + placement_times_ns[first, 0]) // 2
        return cls(int(start_ns), T_before_after)


class PoseErrors(Protocol):
    """The noise of MCS poses per axis, standard deviations, and the error of its scale."""

    mcs_noise_m: float
    mcs_noise_deg: float
    mcs_wander_m: float
    mcs_wander_deg: list[float]
    mcs_wander_s: float
    mcs_scale_error: float


class MocapTruth(Protocol):
    """What the errors of motion capture need of a session; session_recording.SessionTruth."""

    @property
    def placement_times_ns(self) -> np.ndarray: ...

    @property
    def T_body_target(self) -> Mapping[str, np.ndarray]: ...

    @property
    def T_robot_markers(self) -> np.ndarray: ...

    @property
    def mcs_biases(self) -> Mapping[str, np.ndarray]: ...

    @property
    def marker_knock(self) -> MarkerKnock | None: ...

    @property
    def arguments(self) -> PoseErrors: ...

    def true_body_poses(self, name: str, t: np.ndarray) -> np.ndarray: ...


def measure_body_poses(
    session: MocapTruth, rng: np.random.Generator, object_name: str, t: np.ndarray
) -> np.ndarray:
    """Return the poses (n, 4, 4) that the MCS reports at t (n,), ns.

    Bias, wander and white noise act along the axes of the body, the scale on positions in the map.
    """
    if object_name in session.T_body_target:
        T_object_body = invert_pose(session.T_body_target[object_name])
    else:
        T_object_body = _robot_markers_poses(session, t)
    T = session.true_body_poses(object_name, t) @ T_object_body
    bias = interpolate_placement_values(
        t, session.placement_times_ns, session.mcs_biases[object_name]
    )
    errors = session.arguments
    sigma = np.repeat([errors.mcs_noise_m, np.deg2rad(errors.mcs_noise_deg)], 3)
    T = T @ se3_exp(bias) @ se3_exp(sigma * rng.standard_normal((len(t), 6)))
    wander_sigma = np.append(np.full(3, errors.mcs_wander_m), np.deg2rad(errors.mcs_wander_deg))
    if wander_sigma.any():
        T = T @ se3_exp(wander_sigma * draw_gauss_markov(rng, t, errors.mcs_wander_s))
    T[:, :3, 3] *= 1 + errors.mcs_scale_error
    return T


def _robot_markers_poses(session: MocapTruth, t: np.ndarray) -> np.ndarray:
    """Return where the robot's MCS body is on the robot (n, 4, 4) at t (n,), ns."""
    T = np.tile(session.T_robot_markers, (len(t), 1, 1))
    if session.marker_knock is not None:
        start_ns, T_before_after = session.marker_knock
        T[t >= start_ns] = T[t >= start_ns] @ T_before_after
    return T


def draw_gauss_markov(
    rng: np.random.Generator, t: np.ndarray, time_constant_s: float
) -> np.ndarray:
    """Draw six first-order Gauss-Markov processes of σ 1 at times t (n,), ns; returns (n, 6)."""
    kept = np.exp(-np.diff(t) / NS_PER_S / time_constant_s)
    out = rng.standard_normal((len(t), 6))
    for i, share in enumerate(kept.tolist(), 1):
        out[i] = share * out[i - 1] + (1 - share**2) ** 0.5 * out[i]
    return out


def draw_dropouts(
    rng: np.random.Generator,
    n_samples: int,
    dropout_share: float,
    mean_samples: float = MEAN_DROPOUT_SAMPLES,
) -> np.ndarray:
    """Draw which samples (n,) are lost: a share of them in the long run, in bursts.

    mean_samples: lost in a row, on average.
    """
    if not dropout_share:
        return np.zeros(n_samples, bool)
    start_probability = dropout_share / (1 - dropout_share) / mean_samples
    is_lost, u = np.zeros(n_samples, bool), rng.uniform(size=n_samples)
    state = u[0] < dropout_share
    for i in range(n_samples):
        state = u[i] >= 1 / mean_samples if state else u[i] < start_probability
        is_lost[i] = state
    return is_lost


def draw_label_swaps(
    rng: np.random.Generator,
    n_swaps: int,
    body_names: Sequence[str],
    *,
    start_ns: int,
    end_ns: int,
) -> list[LabelSwap]:
    """Draw intervals in which two of the bodies have each other's name, by start."""
    swaps = []
    for _ in range(n_swaps):
        length = rng.integers(*LABEL_SWAP_DURATION_NS)
        begin = rng.integers(start_ns, end_ns - length)
        a, b = sorted(rng.choice(len(body_names), 2, replace=False))
        bodies = body_names[a], body_names[b]
        swaps.append(LabelSwap(int(begin), int(begin + length), bodies))
    return sorted(swaps)


def apply_label_swaps(
    poses: Mapping[str, np.ndarray], t: np.ndarray, swaps: Sequence[LabelSwap]
) -> dict[str, np.ndarray]:
    """Return poses (n, 4, 4) by name at t (n,), ns, with the names exchanged during the swaps."""
    out = {name: T.copy() for name, T in poses.items()}
    for start_ns, end_ns, (a, b) in swaps:
        during = (t >= start_ns) & (t < end_ns)
        out[a][during], out[b][during] = out[b][during], out[a][during]
    return out
