"""Clocks of streams: header stamps compared with log times."""

from typing import Any, NamedTuple

import numpy as np

from calib.decoding.clock_steps import (
    NO_STEPS,
    ClockSteps,
    drop_common_steps,
    find_clock_steps,
)
from calib.geometry.units import NS_PER_S

MAX_MESSAGE_DELAY_NS = NS_PER_S  # with a longer delay the stamp is of another clock


class StreamTimes(NamedTuple):
    """Stamps (n,), -1 if missing, and log times (n,) of a stream, ns."""

    stamps_ns: np.ndarray
    log_times_ns: np.ndarray


class StreamClock(NamedTuple):
    """Where the times of a stream come from.

    shift_ns: added to its stamps, None if log times are used instead; stamp_source: the same as
    text; delay_ns: median of log time minus stamp, None without stamps; steps: of its clock.
    """

    shift_ns: int | None
    stamp_source: str
    delay_ns: int | None
    steps: ClockSteps = NO_STEPS

    def message_times_ns(self, stamps_ns: np.ndarray, log_times_ns: np.ndarray) -> np.ndarray:
        """Return the times (n,), ns, of messages; the log time replaces a missing stamp (-1)."""
        if self.shift_ns is None:
            return log_times_ns
        corrected = self.steps.correct(stamps_ns, log_times_ns)
        return np.where(stamps_ns < 0, log_times_ns, corrected + self.shift_ns)

    def to_dict(self) -> dict[str, Any]:
        """Return the block of log.json."""
        return {
            "stamps": self.stamp_source,
            "delay_s": None if self.delay_ns is None else self.delay_ns / NS_PER_S,
        }


def match_streams_to_log(streams: dict[str, StreamTimes]) -> dict[str, StreamClock]:
    """Return the clock of each stream.

    Streams of one clock that is far from the log's are shifted by the same time, the smallest delay
    among them, so that they stay synchronous. Steps of a clock are taken out before.
    """
    steps = drop_common_steps({name: find_clock_steps(*times) for name, times in streams.items()})
    streams = {
        name: StreamTimes(steps[name].correct(stamps_ns, log_times_ns), log_times_ns)
        for name, (stamps_ns, log_times_ns) in streams.items()
    }
    found = {name: _median_delay(times) for name, times in streams.items()}
    delays = sorted(d for d in found.values() if isinstance(d, int))
    clocks = {}
    for name, delay in found.items():
        if isinstance(delay, str):
            clocks[name] = StreamClock(None, f"log time: {delay}", None)
            continue
        same_clock = _close_delays(delays, delay)
        if any(abs(d) <= MAX_MESSAGE_DELAY_NS for d in same_clock):
            clocks[name] = StreamClock(0, "header", delay, steps[name])
        else:
            shift_ns = same_clock[0]
            source = f"header, shifted by {shift_ns / NS_PER_S:+.3f} s to the log's clock"
            clocks[name] = StreamClock(shift_ns, source, delay, steps[name])
    return clocks


def _median_delay(times: StreamTimes) -> int | str:
    """Return the median of log time minus stamp, ns, or why there is none."""
    stamps, log_times = times
    is_stamped = stamps >= 0
    if 2 * is_stamped.sum() <= len(stamps):
        return "most messages have no stamp"
    steps = np.diff(stamps[is_stamped])
    if len(steps) and 2 * (steps <= 0).sum() > len(steps):
        return "most stamps do not increase"
    return int(np.median(log_times[is_stamped] - stamps[is_stamped]))


def _close_delays(delays: list[int], delay: int) -> list[int]:
    """Return the sorted delays that steps of at most MAX_MESSAGE_DELAY_NS connect to one."""
    first = last = delays.index(delay)
    while first and delays[first] - delays[first - 1] <= MAX_MESSAGE_DELAY_NS:
        first -= 1
    while last + 1 < len(delays) and delays[last + 1] - delays[last] <= MAX_MESSAGE_DELAY_NS:
        last += 1
    return delays[first : last + 1]
