"""What motion capture reports of the bodies: noise, lateness, losses and swapped names."""

import numpy as np

from calib.geometry.se3 import invert_pose, se3_exp
from simulation.world.smooth_motion import interpolate_placement_values

MCS_PERIOD_NS = 10_000_000
MEAN_DROPOUT_SAMPLES = 8  # samples lost in a row, on average
LABEL_SWAP_DURATION_NS = (100_000_000, 300_000_000)  # how long two names stay swapped


def measure_body_poses(session, rng, object_name, t):
    """Poses (n, 4, 4) that the MCS reports at t (n,), ns: with bias and white noise along the axes
    of the body."""
    in_body = (
        invert_pose(session.T_body_target[object_name])
        if object_name in session.T_body_target
        else session.T_robot_markers
    )
    T = session.true_body_poses(object_name, t) @ in_body
    bias = interpolate_placement_values(
        t, session.placement_times_ns, session.mcs_biases[object_name]
    )
    args = session.arguments
    sigma = np.repeat([args.mcs_noise_m, np.deg2rad(args.mcs_noise_deg)], 3)
    return T @ se3_exp(bias) @ se3_exp(sigma * rng.standard_normal((len(t), 6)))


def draw_dropouts(rng, n_samples, dropout_share):
    """Which of n samples are lost: a share of them in the long run, in bursts."""
    if not dropout_share:
        return np.zeros(n_samples, bool)
    begin = dropout_share / (1 - dropout_share) / MEAN_DROPOUT_SAMPLES
    out, u = np.zeros(n_samples, bool), rng.uniform(size=n_samples)
    state = u[0] < dropout_share
    for i in range(n_samples):
        state = u[i] >= 1 / MEAN_DROPOUT_SAMPLES if state else u[i] < begin
        out[i] = state
    return out


def draw_label_swaps(rng, n_swaps, body_names, start, end):
    """Intervals in which two of the bodies are called by each other's name: (start, end, names),
    start and end in ns."""
    swaps = []
    for _ in range(n_swaps):
        length = rng.integers(*LABEL_SWAP_DURATION_NS)
        begin = rng.integers(start, end - length)
        pair = sorted(rng.choice(len(body_names), 2, replace=False))
        swaps.append((int(begin), int(begin + length), tuple(body_names[i] for i in pair)))
    return sorted(swaps)


def apply_label_swaps(poses, t, swaps):
    """Poses by name (n, 4, 4) at t (n,), ns, with the names exchanged during the swaps."""
    out = {name: T.copy() for name, T in poses.items()}
    for begin, end, (a, b) in swaps:
        during = (t >= begin) & (t < end)
        out[a][during], out[b][during] = out[b][during], out[a][during]
    return out
