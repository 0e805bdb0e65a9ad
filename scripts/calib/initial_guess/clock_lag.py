"""By how much a sensor's clock is off, coarsely: when what it sees changes, something moves.

What changes from one frame to the next is ranked, and so is how far robot and targets moved in that
time by the MCS, as its clock may be; at the right offset both ranks are alike. No guess of a pose
has a part in it.
"""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from scipy.stats import rankdata

from calib.geometry.units import NS_PER_S
from calib.io.status import MessageError
from calib.sensors.camera.images.image_messages import to_grey

SEARCH_RANGE_S, SEARCH_STEP_S = 1.2, 0.01  # offsets that are tried beside the stated one
N_BURSTS, N_FRAMES_PER_BURST = 10, 12  # of consecutive frames that are read
MIN_FRAME_INTERVAL_S = 0.09  # from one frame to the next
MIN_MOTION_M_RAD = 0.003  # m or rad; below it nothing moved
MIN_FRAME_PAIRS, MIN_RANK_CORRELATION = (
    20,
    0.5,
)  # pairs of frames, and correlation, that tell an offset
MIN_CORRELATION_GAIN = (
    0.1  # in correlation over the stated offset and over all that are not near the best
)
MIN_OFFSET_SIGMAS = 3.0  # σ of the stated offset: one as near to it is for the solve to find
SAME_OFFSET_S = 0.25  # within which offsets are one answer
SMALL_IMAGE_PX, SMALL_SCAN_CELLS = (
    (64, 48),
    (120, 60),
)  # to which images, and azimuth and elevation, are reduced
MAX_RANGE_CHANGE_M = 1.0  # a range that changed by more counts so much


@dataclass(frozen=True)
class ClockGuess:
    """An offset, s, its σ, and what tells it."""

    offset_s: float
    sigma_s: float
    basis: str


def shrink_image(image):
    """(48, 64) grey levels of an image, and 0: it is taken at its stamp."""
    return cv2.resize(to_grey(image), SMALL_IMAGE_PX, interpolation=cv2.INTER_AREA).astype(float), 0


def shrink_scan(points):
    """(7200,) mean range in the cells of azimuth and elevation, m, NaN in empty ones, and by how
    much the middle of the scan is after its stamp, ns."""
    xyz, _, dt = points
    xyz, distance = xyz.astype(float), np.linalg.norm(xyz, axis=1)
    azimuth, elevation = np.arctan2(xyz[:, 1], xyz[:, 0]), np.arcsin(xyz[:, 2] / distance)
    column = ((azimuth / np.pi + 1) / 2 * (SMALL_SCAN_CELLS[0] - 1)).astype(int)
    row = ((elevation / np.pi + 0.5) * (SMALL_SCAN_CELLS[1] - 1)).astype(int)
    cell, size = column * SMALL_SCAN_CELLS[1] + row, SMALL_SCAN_CELLS[0] * SMALL_SCAN_CELLS[1]
    count, total = np.bincount(cell, minlength=size), np.bincount(cell, distance, size)
    middle = int((dt.min() + dt.max()) // 2) if len(dt) else 0
    return np.where(count > 0, total / np.maximum(count, 1), np.nan), middle


SHRINK_BY_KIND = {"camera": shrink_image, "lidar": shrink_scan}


def choose_bursts(stamps_ns):
    """[indices] of consecutive frames, evenly spread over their stamps stamps_ns (n,), ns."""
    period = np.median(np.diff(stamps_ns)) / NS_PER_S
    stride = max(1, int(np.ceil(MIN_FRAME_INTERVAL_S / period - 1e-3))) if period > 0 else 1
    kept = np.arange(0, len(stamps_ns), stride)
    if len(kept) <= N_BURSTS * N_FRAMES_PER_BURST:
        ends = np.linspace(0, len(kept) - 1, min(N_BURSTS, len(kept) - 1) + 1).astype(int)
        return [kept[a : b + 1] for a, b in zip(ends[:-1], ends[1:], strict=True)]
    starts = np.round(np.linspace(0, len(kept) - N_FRAMES_PER_BURST, N_BURSTS)).astype(int)
    return [kept[s : s + N_FRAMES_PER_BURST] for s in starts]


def measure_changes(kind, stamps_ns, read_frame):
    """Of consecutive frames: times (p, 2), ns, how much changed (p,), and their burst (p,)."""
    times, amount, burst = [], [], []
    for number, rows in enumerate(choose_bursts(stamps_ns)):
        small = [_read_small(kind, read_frame, int(i)) for i in rows]
        for i in np.flatnonzero([a is not None and b is not None for a, b in pairwise(small)]):
            (before, late), (after, later) = small[i], small[i + 1]
            times.append((stamps_ns[rows[i]] + late, stamps_ns[rows[i + 1]] + later))
            amount.append(_mean_difference(before, after))
            burst.append(number)
    return np.reshape(times, (-1, 2)).astype(np.int64), np.array(amount), np.array(burst)


def _read_small(kind, read_frame, i):
    """Frame i reduced, or None where it cannot be read."""
    try:
        return SHRINK_BY_KIND[kind](read_frame(i))
    except MessageError:
        return None


def _mean_difference(a, b):
    """Mean absolute difference where both know something, in grey levels or up to FAR_M."""
    both = np.isfinite(a) & np.isfinite(b)
    away = np.abs(a - b)[both]
    limit = np.inf if a.ndim == 2 else MAX_RANGE_CHANGE_M
    return float(np.minimum(away, limit).mean()) if len(away) else 0.0


def measure_motion(trajectory, times_ns):
    """How far a Trajectory goes between times_ns (..., 2), ns: m plus rad; NaN where it has gaps."""
    T, known = trajectory.poses_at(times_ns.reshape(-1))
    T, known = T.reshape(*times_ns.shape, 4, 4), known.reshape(times_ns.shape).all(-1)
    shift = np.linalg.norm(T[..., 1, :3, 3] - T[..., 0, :3, 3], axis=-1)
    turn = np.swapaxes(T[..., 0, :3, :3], -1, -2) @ T[..., 1, :3, :3]
    angle = np.arccos(np.clip((np.trace(turn, axis1=-2, axis2=-1) - 1) / 2, -1, 1))
    return np.where(known, shift + angle, np.nan)


def find_clock_lag(kind, stamps_ns, read_frame, trajectories, offset_prior):
    """The Lag of a sensor with stamps stamps_ns (n,), ns, or None where the data tell none that is sure to
    be another than the stated one: {value, sigma}, s.

    trajectories: Trajectories of all bodies in the map frame; content_of(i) reads what a frame measured.
    """
    if len(stamps_ns) < MIN_FRAME_PAIRS or not trajectories:
        return None
    times, amount, burst = measure_changes(kind, stamps_ns, read_frame)
    if len(times) < MIN_FRAME_PAIRS:
        return None
    tried = offset_prior["value"] + np.arange(
        -SEARCH_RANGE_S, SEARCH_RANGE_S + SEARCH_STEP_S / 2, SEARCH_STEP_S
    )
    late = np.round(tried * NS_PER_S).astype(np.int64)
    motion = sum(measure_motion(p, times[None] + late[:, None, None]) for p in trajectories)
    score = rank_correlations(motion, amount)
    best, now = int(np.argmax(score)), int(np.argmin(np.abs(tried - offset_prior["value"])))
    found = tried[best]
    without = [
        tried[np.argmax(rank_correlations(motion[:, burst != b], amount[burst != b]))]
        for b in np.unique(burst)
    ]
    rival = score[np.abs(tried - found) > SAME_OFFSET_S].max()
    sure = (
        score[best] > MIN_RANK_CORRELATION
        and score[best] - max(rival, score[now]) > MIN_CORRELATION_GAIN
    )
    if not sure or abs(found - offset_prior["value"]) < MIN_OFFSET_SIGMAS * offset_prior["sigma"]:
        return None
    near = np.clip(without - found, -SAME_OFFSET_S, SAME_OFFSET_S)
    spread = np.sqrt((len(without) - 1) / len(without) * np.sum(near**2))
    sigma = float(np.hypot(max(spread, SEARCH_STEP_S), np.median(np.diff(times)) / NS_PER_S / 4))
    return ClockGuess(
        float(found), sigma, f"{len(amount)} pairs of frames change as the MCS moves "
        f"(rank correlation {score[best]:.2f}, {score[now]:.2f} without the offset)",
    )  # fmt: skip


def rank_correlations(motion, amount):
    """(k,) rank correlation of how far things moved (k, p) with what changed (p,); -1 where fewer
    than LEAST_PAIRS are known."""
    out = np.full(len(motion), -1.0)
    for i, row in enumerate(motion):
        known = np.isfinite(row)
        if known.sum() >= MIN_FRAME_PAIRS and np.ptp(row[known]) > MIN_MOTION_M_RAD:
            ranks = rankdata(np.maximum(row[known], MIN_MOTION_M_RAD)), rankdata(amount[known])
            out[i] = np.corrcoef(*ranks)[0, 1]
    return out
