"""Steps of a clock within a log, from log time minus stamp.

A clock that is set while it is recorded moves this difference at once, and it stays there. Late
messages move it too, but it comes back, and it never falls below that of prompt messages.
"""

from typing import Any, NamedTuple

import numpy as np

from calib.geometry.units import MS_PER_S, NS_PER_S

MIN_STEP_NS = 10_000_000  # a target at 0.5 m/s moves by 5 mm
MIN_STEP_SPREADS = 3.0  # size of a step over the interquartile range of the delays around it
WINDOW_NS = 2 * NS_PER_S  # before and after a step, whose delays are compared
MIN_WINDOW_MESSAGES = 5
STEP_MARGIN_S = 0.5  # between a step and the sessions before and after it


class ClockSteps(NamedTuple):
    """Steps of the clock of one stream: log times (k,), ns, and delays (k + 1,) between, ns."""

    log_times_ns: np.ndarray
    delays_ns: np.ndarray

    def correct(self, stamps_ns: np.ndarray, log_times_ns: np.ndarray) -> np.ndarray:
        """Return stamps (n,) on the clock before the first step; missing ones (-1) stay."""
        part = np.searchsorted(self.log_times_ns, log_times_ns, "right")
        # After a step backwards the log holds messages from before and after it side by side.
        delays = log_times_ns - stamps_ns
        for k, time_ns in enumerate(self.log_times_ns.tolist()):
            size = abs(int(self.delays_ns[k + 1] - self.delays_ns[k]))
            near = np.abs(log_times_ns - time_ns) <= size
            is_after = np.abs(delays - self.delays_ns[k + 1]) < np.abs(delays - self.delays_ns[k])
            part = np.where(near, k + is_after, part)
        shifted = stamps_ns + self.delays_ns[part] - self.delays_ns[0]
        return np.where(stamps_ns < 0, stamps_ns, shifted)


NO_STEPS = ClockSteps(np.zeros(0, np.int64), np.zeros(1, np.int64))


def find_clock_steps(stamps_ns: np.ndarray, log_times_ns: np.ndarray) -> ClockSteps:
    """Return the steps of the clock of a stream; stamps (n,), -1 if missing, in log order."""
    is_stamped = stamps_ns >= 0
    t, delays = log_times_ns[is_stamped], (log_times_ns - stamps_ns)[is_stamped]
    rows = _step_rows(t, delays)
    while True:
        levels = [float(np.median(part)) for part in np.split(delays, rows)] if len(t) else [0.0]
        kept = _without_late_parts(rows, levels)
        if len(kept) == len(rows):
            break
        rows = kept
    if not rows:
        return NO_STEPS
    return ClockSteps(t[rows], np.array(levels).round().astype(np.int64))


def _step_rows(t: np.ndarray, delays: np.ndarray) -> list[int]:
    """Return the rows of the first messages after each step of the delays, in order."""
    sizes = {}
    for row in (np.flatnonzero(np.abs(np.diff(delays)) > MIN_STEP_NS / 2) + 1).tolist():
        size = _step_size(t, delays, row)
        if size:
            sizes[row] = size
    found: list[int] = []
    for row in sorted(sizes, key=lambda r: -sizes[r]):
        if all(abs(t[row] - t[other]) > WINDOW_NS for other in found):
            found.append(row)
    return sorted(found)


def _step_size(t: np.ndarray, delays: np.ndarray, row: int) -> float:
    """Return the size of a step of the delays at a row, ns; 0 if it is no larger than they vary."""
    first = min(np.searchsorted(t, t[row] - WINDOW_NS), row - MIN_WINDOW_MESSAGES)
    last = max(np.searchsorted(t, t[row] + WINDOW_NS), row + MIN_WINDOW_MESSAGES)
    if first < 0 or last > len(t):
        return 0.0
    if min(t[row] - t[first], t[last - 1] - t[row]) < WINDOW_NS / 2:
        return 0.0
    before, after = (
        np.quantile(d, (0.25, 0.5, 0.75)) for d in (delays[first:row], delays[row:last])
    )
    spread = max(before[2] - before[0], after[2] - after[0])
    size = abs(after[1] - before[1])
    return float(size) if size > max(MIN_STEP_NS, MIN_STEP_SPREADS * spread) else 0.0


def _without_late_parts(rows: list[int], levels: list[float]) -> list[int]:
    """Return the rows without the first pair around messages that were late for a while."""
    for k in range(1, len(levels) - 1):
        returns = abs(levels[k + 1] - levels[k - 1]) < MIN_STEP_NS
        if returns and levels[k] > max(levels[k - 1], levels[k + 1]):
            return rows[: k - 1] + rows[k + 1 :]
    return rows


def drop_common_steps(steps: dict[str, ClockSteps]) -> dict[str, ClockSteps]:
    """Return the steps by stream, without those that all streams have: of the log's own clock."""
    if len(steps) < 2 or not all(len(s.log_times_ns) for s in steps.values()):
        return steps
    first = next(iter(steps.values()))
    for other in steps.values():
        same_count = len(other.log_times_ns) == len(first.log_times_ns)
        if not same_count or not _are_same_steps(first, other):
            return steps
    return dict.fromkeys(steps, NO_STEPS)


def _are_same_steps(a: ClockSteps, b: ClockSteps) -> bool:
    apart = np.abs(a.log_times_ns - b.log_times_ns).max()
    unlike = np.abs(np.diff(a.delays_ns) - np.diff(b.delays_ns)).max()
    return bool(apart < WINDOW_NS and unlike < MIN_STEP_NS)


def clock_steps_json(name: str, steps: ClockSteps, log_start_ns: int) -> list[dict[str, Any]]:
    """Return [{at_s, size_s, text, remedy}] of a stream, for log.json.

    at_s: after the first message of the log, as from_s and to_s.
    """
    out = []
    sizes = np.diff(steps.delays_ns).tolist()
    for time_ns, size_ns in zip(steps.log_times_ns.tolist(), sizes, strict=True):
        at_s = (time_ns - log_start_ns) / NS_PER_S
        text = (
            f"{name}: log time minus stamp jumped by {size_ns / NS_PER_S * MS_PER_S:+.0f} ms at "
            f"{at_s:.1f} s of the log: a clock was set. Later stamps are corrected by that"
        )
        remedy = (
            "Make two sessions of this log, one with "
            f"to_s: {max(0.0, at_s - STEP_MARGIN_S):.1f}, one with from_s: "
            f"{at_s + STEP_MARGIN_S:.1f}. Before the next recording, let the clocks settle."
        )
        block = {"at_s": at_s, "size_s": size_ns / NS_PER_S, "text": text, "remedy": remedy}
        out.append(block)
    return out
