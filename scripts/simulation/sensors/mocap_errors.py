"""What motion capture reports of the bodies: noise, lateness, losses and swapped names."""

import numpy as np

from calib.geometry.se3 import inverse, se3_exp
from simulation.world import smooth_motion

PERIOD_NS = 10_000_000
BURST = 8  # samples lost in a row, on average
SWAP_NS = (100_000_000, 300_000_000)  # how long two names stay swapped


def measured(session, rng, name, t):
    """Poses (n, 4, 4) that the MCS reports at t (n,), ns: with bias and white noise along the axes
    of the body."""
    in_body = inverse(session.mounts[name]) if name in session.mounts else session.markers
    T = session.T_world(name, t) @ in_body
    bias = smooth_motion.values_at(t, session.times, session.biases[name])
    args = session.args
    sigma = np.repeat([args.mcs_noise_m, np.deg2rad(args.mcs_noise_deg)], 3)
    return T @ se3_exp(bias) @ se3_exp(sigma * rng.standard_normal((len(t), 6)))


def lost(rng, n, share):
    """Which of n samples are lost: a share of them in the long run, in bursts."""
    if not share:
        return np.zeros(n, bool)
    begin = share / (1 - share) / BURST
    out, u = np.zeros(n, bool), rng.uniform(size=n)
    state = u[0] < share
    for i in range(n):
        state = u[i] >= 1 / BURST if state else u[i] < begin
        out[i] = state
    return out


def draw_swaps(rng, count, names, start, end):
    """Intervals in which two of the bodies are called by each other's name: (start, end, names),
    start and end in ns."""
    swaps = []
    for _ in range(count):
        length = rng.integers(*SWAP_NS)
        begin = rng.integers(start, end - length)
        pair = sorted(rng.choice(len(names), 2, replace=False))
        swaps.append((int(begin), int(begin + length), tuple(names[i] for i in pair)))
    return sorted(swaps)


def swapped(poses, t, swaps):
    """Poses by name (n, 4, 4) at t (n,), ns, with the names exchanged during the swaps."""
    out = {name: T.copy() for name, T in poses.items()}
    for begin, end, (a, b) in swaps:
        during = (t >= begin) & (t < end)
        out[a][during], out[b][during] = out[b][during], out[a][during]
    return out
