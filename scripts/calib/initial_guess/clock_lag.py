"""Find a coarse time offset of a sensor: what it sees changes while something moves.

The change from each frame to the next, and the motion of robot and targets in that time, are both
ranked. At the right offset the ranks agree. Poses of the sensor are not needed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.stats import rankdata

from calib.geometry.units import NS_PER_S
from calib.initial_guess.initial_guess import SOURCE_DATA, OffsetGuess
from calib.io.status import MessageError, failure_status
from calib.mocap.body_trajectory import Trajectory
from calib.sensors.camera.images.image_messages import to_grey
from calib.sensors.lidar.clouds.cloud_messages import LidarPoints
from calib.views.sensor_croppers import FrameReader

SEARCH_RANGE_S = 1.2  # to both sides of the stated offset
SEARCH_STEP_S = 0.01
N_BURSTS = 10
N_FRAMES_PER_BURST = 12
MIN_FRAME_INTERVAL_S = 0.09
MIN_MOTION_M_RAD = 0.003  # m plus rad; less is noise
MIN_FRAME_PAIRS = 20
MIN_RANK_CORRELATION = 0.5
# Over the correlation at the stated offset and at all offsets that are not near the best one.
MIN_CORRELATION_GAIN = 0.1
MIN_OFFSET_SIGMAS = 3.0  # a smaller difference to the stated offset is left to the solve
SAME_OFFSET_S = 0.25  # offsets within this are one answer
SMALL_IMAGE_PX = (64, 48)
SMALL_SCAN_CELLS = (120, 60)  # azimuth, elevation
MAX_RANGE_CHANGE_M = 1.0  # larger changes count as this


class SmallFrame(NamedTuple):
    """Few values of a frame, NaN if unknown, and how long after its stamp they are measured, ns."""

    values: np.ndarray
    delay_ns: int


@dataclass(frozen=True)
class FrameChanges:
    """Pairs of consecutive frames: their times (p, 2), ns, change (p,) and number of burst (p,)."""

    times_ns: np.ndarray
    amount: np.ndarray
    burst: np.ndarray


@dataclass(frozen=True)
class OffsetSearch:
    """Offsets (k,), s, motion (k, p) between the frames at each, and rank correlations (k,)."""

    offsets_s: np.ndarray
    motion: np.ndarray
    correlation: np.ndarray


def shrink_image(image: np.ndarray) -> SmallFrame:
    """Return grey levels (48, 64) of an image."""
    small = cv2.resize(to_grey(image), SMALL_IMAGE_PX, interpolation=cv2.INTER_AREA)
    return SmallFrame(small.astype(float), 0)


def shrink_scan(points: LidarPoints) -> SmallFrame:
    """Return mean ranges (7200,), m, by azimuth and elevation, at the middle of the scan."""
    xyz, point_time_ns = points.xyz.astype(float), points.dt
    distance = np.linalg.norm(xyz, axis=1)
    azimuth, elevation = np.arctan2(xyz[:, 1], xyz[:, 0]), np.arcsin(xyz[:, 2] / distance)
    column = ((azimuth / np.pi + 1) / 2 * (SMALL_SCAN_CELLS[0] - 1)).astype(int)
    row = ((elevation / np.pi + 0.5) * (SMALL_SCAN_CELLS[1] - 1)).astype(int)
    cell, n_cells = column * SMALL_SCAN_CELLS[1] + row, SMALL_SCAN_CELLS[0] * SMALL_SCAN_CELLS[1]
    count, total = np.bincount(cell, minlength=n_cells), np.bincount(cell, distance, n_cells)
    middle = int((point_time_ns.min() + point_time_ns.max()) // 2) if len(point_time_ns) else 0
    return SmallFrame(np.where(count > 0, total / np.maximum(count, 1), np.nan), middle)


SHRINK_BY_KIND: dict[str, Callable[[Any], SmallFrame]] = {
    "camera": shrink_image,
    "lidar": shrink_scan,
}


def choose_bursts(stamps_ns: np.ndarray) -> list[np.ndarray]:
    """Return indices of consecutive frames, in bursts evenly spread over the stamps (n,), ns."""
    period = np.median(np.diff(stamps_ns)) / NS_PER_S
    stride = max(1, int(np.ceil(MIN_FRAME_INTERVAL_S / period - 1e-3))) if period > 0 else 1
    kept = np.arange(0, len(stamps_ns), stride)
    if len(kept) <= N_BURSTS * N_FRAMES_PER_BURST:
        ends = np.linspace(0, len(kept) - 1, min(N_BURSTS, len(kept) - 1) + 1).astype(int)
        return [kept[a : b + 1] for a, b in zip(ends[:-1], ends[1:], strict=True)]
    starts = np.round(np.linspace(0, len(kept) - N_FRAMES_PER_BURST, N_BURSTS)).astype(int)
    return [kept[s : s + N_FRAMES_PER_BURST] for s in starts]


def measure_changes(kind: str, stamps_ns: np.ndarray, read_frame: FrameReader) -> FrameChanges:
    """Measure the change between consecutive frames; frames that cannot be read are left out."""
    times, amount, burst = [], [], []
    for number, rows in enumerate(choose_bursts(stamps_ns)):
        frames = [_read_small_frame(kind, read_frame, int(i)) for i in rows]
        for (i, before), (j, after) in pairwise(zip(rows, frames, strict=True)):
            if before is None or after is None:
                continue
            times.append((stamps_ns[i] + before.delay_ns, stamps_ns[j] + after.delay_ns))
            amount.append(_mean_difference(before.values, after.values))
            burst.append(number)
    times_ns = np.reshape(times, (-1, 2)).astype(np.int64)
    return FrameChanges(times_ns, np.array(amount), np.array(burst))


def _read_small_frame(kind: str, read_frame: FrameReader, i: int) -> SmallFrame | None:
    """Return frame i reduced, or None if it cannot be read."""
    try:
        return SHRINK_BY_KIND[kind](read_frame(i))
    except MessageError:
        return None


def _mean_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the mean absolute difference of known values: grey levels, or m up to a limit."""
    is_known = np.isfinite(a) & np.isfinite(b)
    difference = np.abs(a - b)[is_known]
    limit = np.inf if a.ndim == 2 else MAX_RANGE_CHANGE_M
    return float(np.minimum(difference, limit).mean()) if len(difference) else 0.0


def measure_motion(trajectory: Trajectory, times_ns: np.ndarray) -> np.ndarray:
    """Return the motion (...) between times_ns (..., 2): m plus rad; NaN in gaps."""
    poses, has_pose = trajectory.poses_at(times_ns.reshape(-1))
    T = poses.reshape(*times_ns.shape, 4, 4)
    is_known = np.all(has_pose.reshape(times_ns.shape), axis=-1)
    shift = np.linalg.norm(T[..., 1, :3, 3] - T[..., 0, :3, 3], axis=-1)
    turn = np.swapaxes(T[..., 0, :3, :3], -1, -2) @ T[..., 1, :3, :3]
    angle = np.arccos(np.clip((np.trace(turn, axis1=-2, axis2=-1) - 1) / 2, -1, 1))
    return np.where(is_known, shift + angle, np.nan)


def find_clock_lag(
    kind: str,
    stamps_ns: np.ndarray,
    read_frame: FrameReader,
    trajectories: Sequence[Trajectory],
    config_offset: Mapping[str, float],
) -> OffsetGuess:
    """Search the time offset of a sensor, s.

    stamps_ns: (n,). trajectories: of all bodies in the map frame. config_offset: stated value and
    sigma, s. The guess has no value, and a status that says why, unless the data clearly show an
    offset that the stated one does not allow.
    """
    if len(stamps_ns) < MIN_FRAME_PAIRS or not trajectories:
        return _no_offset("too few frames", f"{len(stamps_ns)} frames", f"{MIN_FRAME_PAIRS}")
    changes = measure_changes(kind, stamps_ns, read_frame)
    if len(changes.times_ns) < MIN_FRAME_PAIRS:
        found = f"{len(changes.times_ns)} pairs of frames"
        return _no_offset("too few frames", found, f"{MIN_FRAME_PAIRS}")
    return _judge_offsets(
        changes, _search_offsets(changes, trajectories, config_offset["value"]), config_offset
    )


def _judge_offsets(
    changes: FrameChanges, search: OffsetSearch, config_offset: Mapping[str, float]
) -> OffsetGuess:
    """Return the best offset, or why it is not clear or not different from the stated one."""
    best = int(np.argmax(search.correlation))
    offset_s, correlation = search.offsets_s[best], search.correlation[best]
    stated = int(np.argmin(np.abs(search.offsets_s - config_offset["value"])))
    stated_correlation = search.correlation[stated]
    is_rival = np.abs(search.offsets_s - offset_s) > SAME_OFFSET_S
    rival_correlation = max(search.correlation[is_rival].max(), stated_correlation)
    gain = correlation - rival_correlation
    if not (correlation > MIN_RANK_CORRELATION and gain > MIN_CORRELATION_GAIN):
        found = f"rank correlation {correlation:.2f}, {rival_correlation:.2f} at another offset"
        expected = f"above {MIN_RANK_CORRELATION}, and {MIN_CORRELATION_GAIN} above all others"
        return _no_offset("no clear offset", found, expected)
    difference_s = abs(offset_s - config_offset["value"])
    if difference_s < MIN_OFFSET_SIGMAS * config_offset["sigma"]:
        found = f"{offset_s:.2f} s, within {MIN_OFFSET_SIGMAS:g} sigma of the stated offset"
        return _no_offset("the stated offset is used", found)
    return OffsetGuess(
        value=float(offset_s),
        sigma=_offset_sigma(changes, search, offset_s),
        basis=f"{len(changes.amount)} pairs of frames change as the MCS moves (rank correlation "
        f"{correlation:.2f}, {stated_correlation:.2f} without the offset)",
        source=SOURCE_DATA,
    )


def _no_offset(reason: str, found: str, expected: str = "") -> OffsetGuess:
    return OffsetGuess(status=failure_status(reason, found, expected))


def _search_offsets(
    changes: FrameChanges, trajectories: Sequence[Trajectory], stated_offset_s: float
) -> OffsetSearch:
    """Correlate change and motion at all offsets around the stated one."""
    steps = np.arange(-SEARCH_RANGE_S, SEARCH_RANGE_S + SEARCH_STEP_S / 2, SEARCH_STEP_S)
    offsets_s = stated_offset_s + steps
    offsets_ns = np.round(offsets_s * NS_PER_S).astype(np.int64)
    times_ns = changes.times_ns[None] + offsets_ns[:, None, None]
    motion = sum(
        (measure_motion(trajectory, times_ns) for trajectory in trajectories), start=np.zeros(1)
    )
    return OffsetSearch(offsets_s, motion, rank_correlations(motion, changes.amount))


def _offset_sigma(changes: FrameChanges, search: OffsetSearch, offset_s: float) -> float:
    """Return the σ of the best offset, s: a jackknife over the bursts, and a quarter interval."""
    offsets_s = [
        search.offsets_s[
            np.argmax(rank_correlations(search.motion[:, is_kept], changes.amount[is_kept]))
        ]
        for is_kept in (changes.burst != b for b in np.unique(changes.burst))
    ]
    deviation = np.clip(np.array(offsets_s) - offset_s, -SAME_OFFSET_S, SAME_OFFSET_S)
    spread = np.sqrt((len(offsets_s) - 1) / len(offsets_s) * np.sum(deviation**2))
    interval_s = np.median(np.diff(changes.times_ns)) / NS_PER_S
    return float(np.hypot(max(spread, SEARCH_STEP_S), interval_s / 4))


def rank_correlations(motion: np.ndarray, amount: np.ndarray) -> np.ndarray:
    """Return rank correlations (k,) of motion (k, p) and change (p,).

    -1 if fewer than MIN_FRAME_PAIRS are known or nothing moves.
    """
    correlation = np.full(len(motion), -1.0)
    for i, row in enumerate(motion):
        is_known = np.isfinite(row)
        if is_known.sum() >= MIN_FRAME_PAIRS and np.ptp(row[is_known]) > MIN_MOTION_M_RAD:
            motion_ranks = rankdata(np.maximum(row[is_known], MIN_MOTION_M_RAD))
            correlation[i] = np.corrcoef(motion_ranks, rankdata(amount[is_known]))[0, 1]
    return correlation
