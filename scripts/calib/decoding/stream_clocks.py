"""Stamps of headers against the times at which the log took the messages."""

from typing import NamedTuple

import numpy as np

from calib.geometry.units import NS_PER_S

MAX_MESSAGE_DELAY_NS = NS_PER_S  # no message is on its way for longer: another clock made its stamp


class StreamClock(NamedTuple):
    """Where a stream's times come from.

    shift: ns to add to its stamps, None where the log's times stand for them; words: which; delay:
    median of log time minus stamp, ns, None without stamps.
    """

    shift_ns: int | None
    stamp_source: str
    delay_ns: int | None

    def message_times_ns(self, stamps_ns, log_times_ns):
        """Times (n,) of messages with stamps t, -1 where there is none, and log times log_t, ns."""
        if self.shift_ns is None:
            return log_times_ns
        return np.where(stamps_ns < 0, log_times_ns, stamps_ns + self.shift_ns)

    def to_dict(self):
        """For the audit."""
        return {
            "stamps": self.stamp_source,
            "delay_s": None if self.delay_ns is None else self.delay_ns / NS_PER_S,
        }


def match_streams_to_log(streams):
    """{name: Clock} of {name: (t, log_t)}: stamps (n,), -1 where there is none, log times (n,), ns.

    Streams of one clock that is far from the log's are moved by the same time, that of the one
    that was on its way for the shortest: among themselves they stay as they were stamped.
    """
    told = {name: _median_delay(*of) for name, of in streams.items()}
    delays = sorted(d for d in told.values() if isinstance(d, int))
    out = {}
    for name, delay in told.items():
        if isinstance(delay, str):
            out[name] = StreamClock(None, f"log time: {delay}", None)
            continue
        alike = _close_delays(delays, delay)
        if any(abs(d) <= MAX_MESSAGE_DELAY_NS for d in alike):
            out[name] = StreamClock(0, "header", delay)
        else:
            words = f"header, moved by {alike[0] / NS_PER_S:+.3f} s onto the log's clock"
            out[name] = StreamClock(alike[0], words, delay)
    return out


def _median_delay(t, log_t):
    """Median of log time minus stamp, ns, or in words why there is none."""
    stamped = t >= 0
    if 2 * stamped.sum() <= len(t):
        return "messages without a stamp"
    steps = np.diff(t[stamped])
    if len(steps) and 2 * (steps <= 0).sum() > len(steps):
        return "stamps that do not go on"
    return int(np.median(log_t[stamped] - t[stamped]))


def _close_delays(delays, delay):
    """Those of sorted delays that steps of at most FAR_NS lead to from one of them."""
    at = delays.index(delay)
    first = last = at
    while first and delays[first] - delays[first - 1] <= MAX_MESSAGE_DELAY_NS:
        first -= 1
    while last + 1 < len(delays) and delays[last + 1] - delays[last] <= MAX_MESSAGE_DELAY_NS:
        last += 1
    return delays[first : last + 1]
