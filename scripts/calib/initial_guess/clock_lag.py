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

from calib.io.status import MessageError
from calib.mocap.body_trajectory import NS
from calib.sensors.camera.images import image_messages

REACH_S, STEP_S = 1.2, 0.01  # offsets that are tried beside the stated one
BURSTS, FRAMES = 10, 12  # of consecutive frames that are read
LEAST_S = 0.09  # from one frame to the next
STILL = 0.003  # m or rad; below it nothing moved
LEAST_PAIRS, LEAST_RANK = 20, 0.5  # pairs of frames, and correlation, that tell an offset
LEAST_GAIN = 0.1  # in correlation over the stated offset and over all that are not near the best
CLOSER = 3.0  # σ of the stated offset: one as near to it is for the solve to find
ALIKE_S = 0.25  # within which offsets are one answer
PIXELS, CELLS = (64, 48), (120, 60)  # to which images, and azimuth and elevation, are reduced
FAR_M = 1.0  # a range that changed by more counts so much


@dataclass(frozen=True)
class Lag:
    """An offset, s, its σ, and what tells it."""

    value: float
    sigma: float
    basis: str


def small_image(image):
    """(48, 64) grey levels of an image, and 0: it is taken at its stamp."""
    return cv2.resize(image_messages.grey(image), PIXELS, interpolation=cv2.INTER_AREA).astype(
        float
    ), 0


def small_scan(points):
    """(7200,) mean range in the cells of azimuth and elevation, m, NaN in empty ones, and by how
    much the middle of the scan is after its stamp, ns."""
    xyz, _, dt = points
    xyz, distance = xyz.astype(float), np.linalg.norm(xyz, axis=1)
    azimuth, elevation = np.arctan2(xyz[:, 1], xyz[:, 0]), np.arcsin(xyz[:, 2] / distance)
    column = ((azimuth / np.pi + 1) / 2 * (CELLS[0] - 1)).astype(int)
    row = ((elevation / np.pi + 0.5) * (CELLS[1] - 1)).astype(int)
    cell, size = column * CELLS[1] + row, CELLS[0] * CELLS[1]
    count, total = np.bincount(cell, minlength=size), np.bincount(cell, distance, size)
    middle = int((dt.min() + dt.max()) // 2) if len(dt) else 0
    return np.where(count > 0, total / np.maximum(count, 1), np.nan), middle


SMALL = {"camera": small_image, "lidar": small_scan}


def bursts(t):
    """[indices] of consecutive frames, evenly spread over their stamps t (n,), ns."""
    period = np.median(np.diff(t)) / NS
    stride = max(1, int(np.ceil(LEAST_S / period - 1e-3))) if period > 0 else 1
    kept = np.arange(0, len(t), stride)
    if len(kept) <= BURSTS * FRAMES:
        ends = np.linspace(0, len(kept) - 1, min(BURSTS, len(kept) - 1) + 1).astype(int)
        return [kept[a : b + 1] for a, b in zip(ends[:-1], ends[1:], strict=True)]
    starts = np.round(np.linspace(0, len(kept) - FRAMES, BURSTS)).astype(int)
    return [kept[s : s + FRAMES] for s in starts]


def changes(kind, t, content_of):
    """Of consecutive frames: times (p, 2), ns, how much changed (p,), and their burst (p,)."""
    times, amount, burst = [], [], []
    for number, rows in enumerate(bursts(t)):
        small = [_small(kind, content_of, int(i)) for i in rows]
        for i in np.flatnonzero([a is not None and b is not None for a, b in pairwise(small)]):
            (before, late), (after, later) = small[i], small[i + 1]
            times.append((t[rows[i]] + late, t[rows[i + 1]] + later))
            amount.append(_difference(before, after))
            burst.append(number)
    return np.reshape(times, (-1, 2)).astype(np.int64), np.array(amount), np.array(burst)


def _small(kind, content_of, i):
    """Frame i reduced, or None where it cannot be read."""
    try:
        return SMALL[kind](content_of(i))
    except MessageError:
        return None


def _difference(a, b):
    """Mean absolute difference where both know something, in grey levels or up to FAR_M."""
    both = np.isfinite(a) & np.isfinite(b)
    away = np.abs(a - b)[both]
    limit = np.inf if a.ndim == 2 else FAR_M
    return float(np.minimum(away, limit).mean()) if len(away) else 0.0


def moved(path, times):
    """How far a Trajectory goes between times (..., 2), ns: m plus rad; NaN where it has gaps."""
    T, known = path.at(times.reshape(-1))
    T, known = T.reshape(*times.shape, 4, 4), known.reshape(times.shape).all(-1)
    shift = np.linalg.norm(T[..., 1, :3, 3] - T[..., 0, :3, 3], axis=-1)
    turn = np.swapaxes(T[..., 0, :3, :3], -1, -2) @ T[..., 1, :3, :3]
    angle = np.arccos(np.clip((np.trace(turn, axis1=-2, axis2=-1) - 1) / 2, -1, 1))
    return np.where(known, shift + angle, np.nan)


def find(kind, t, content_of, paths, stated):
    """The Lag of a sensor with stamps t (n,), ns, or None where the data tell none that is sure to
    be another than the stated one: {value, sigma}, s.

    paths: Trajectories of all bodies in the map frame; content_of(i) reads what a frame measured.
    """
    if len(t) < LEAST_PAIRS or not paths:
        return None
    times, amount, burst = changes(kind, t, content_of)
    if len(times) < LEAST_PAIRS:
        return None
    tried = stated["value"] + np.arange(-REACH_S, REACH_S + STEP_S / 2, STEP_S)
    late = np.round(tried * NS).astype(np.int64)
    motion = sum(moved(p, times[None] + late[:, None, None]) for p in paths)
    score = correlations(motion, amount)
    best, now = int(np.argmax(score)), int(np.argmin(np.abs(tried - stated["value"])))
    found = tried[best]
    without = [
        tried[np.argmax(correlations(motion[:, burst != b], amount[burst != b]))]
        for b in np.unique(burst)
    ]
    rival = score[np.abs(tried - found) > ALIKE_S].max()
    sure = score[best] > LEAST_RANK and score[best] - max(rival, score[now]) > LEAST_GAIN
    if not sure or abs(found - stated["value"]) < CLOSER * stated["sigma"]:
        return None
    near = np.clip(without - found, -ALIKE_S, ALIKE_S)
    spread = np.sqrt((len(without) - 1) / len(without) * np.sum(near**2))
    sigma = float(np.hypot(max(spread, STEP_S), np.median(np.diff(times)) / NS / 4))
    return Lag(
        float(found), sigma, f"{len(amount)} pairs of frames change as the MCS moves "
        f"(rank correlation {score[best]:.2f}, {score[now]:.2f} without the offset)",
    )  # fmt: skip


def correlations(motion, amount):
    """(k,) rank correlation of how far things moved (k, p) with what changed (p,); -1 where fewer
    than LEAST_PAIRS are known."""
    out = np.full(len(motion), -1.0)
    for i, row in enumerate(motion):
        known = np.isfinite(row)
        if known.sum() >= LEAST_PAIRS and np.ptp(row[known]) > STILL:
            ranks = rankdata(np.maximum(row[known], STILL)), rankdata(amount[known])
            out[i] = np.corrcoef(*ranks)[0, 1]
    return out
