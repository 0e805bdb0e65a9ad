"""Steps of a clock within a log, from log time minus stamp."""

import numpy as np
import pytest

from calib.decoding.clock_steps import clock_steps_json, drop_common_steps, find_clock_steps
from calib.decoding.stream_clocks import StreamTimes, match_streams_to_log
from calib.geometry.units import NS_PER_S

NS_PER_MS = 1_000_000
START_NS = 10**18
PROMPT_NS = 4 * NS_PER_MS


def recorded(duration_s=20, rate_hz=100, seed=0):
    """Stamps and log times, ns, of a stream that is logged 4 to 6 ms late."""
    rng = np.random.default_rng(seed)
    stamps = START_NS + np.arange(0, duration_s * NS_PER_S, NS_PER_S // rate_hz)
    return stamps, stamps + PROMPT_NS + rng.integers(0, 2 * NS_PER_MS, len(stamps))


def reception_over_wifi(n, seed):
    """Delays, ns: 3 ms and 8 ms on average more, 3 % stalls of 30 to 120 ms."""
    rng = np.random.default_rng(seed)
    stalls = (rng.random(n) < 0.03) * rng.uniform(30, 120, n)
    return ((3 + rng.exponential(8, n) + stalls) * NS_PER_MS).astype(np.int64)


def by_log_time(stamps, log_times):
    order = np.argsort(log_times, kind="stable")
    return stamps[order], log_times[order]


@pytest.mark.parametrize("size_ms", [-400, -60, 25, 150, 2500])
def test_a_step_of_the_logs_clock_is_found_and_taken_out(size_ms):
    stamps, log_times = recorded()
    true = log_times + np.where(np.arange(2000) >= 900, size_ms * NS_PER_MS, 0)
    stamps, log_times = by_log_time(stamps, true)
    steps = find_clock_steps(stamps, log_times)
    assert np.diff(steps.delays_ns) / NS_PER_MS == pytest.approx([size_ms], abs=0.5)
    delays = log_times - steps.correct(stamps, log_times)
    assert abs(delays - PROMPT_NS - NS_PER_MS).max() < 2 * NS_PER_MS


def test_two_steps_of_a_clock_are_told_apart():
    stamps, log_times = recorded()
    n = np.arange(2000)
    log_times = (
        log_times + np.where(n >= 700, 50, 0) * NS_PER_MS + np.where(n >= 1400, 70, 0) * NS_PER_MS
    )
    steps = find_clock_steps(stamps, log_times)
    assert np.diff(steps.delays_ns) / NS_PER_MS == pytest.approx([50, 70], abs=0.5)


def test_a_step_is_found_in_images_at_3_hz():
    stamps, log_times = recorded(rate_hz=3)
    n = len(stamps)
    log_times = log_times + np.where(np.arange(n) >= n // 2, 100 * NS_PER_MS, 0)
    assert len(find_clock_steps(stamps, log_times).log_times_ns) == 1


@pytest.mark.parametrize("seed", range(5))
def test_stalls_and_bursts_of_a_network_are_no_step(seed):
    stamps, _ = recorded(duration_s=60)
    late = np.maximum.accumulate(stamps + reception_over_wifi(len(stamps), seed))
    assert len(find_clock_steps(stamps, late).log_times_ns) == 0
    stepped = late + np.where(np.arange(len(late)) >= 2000, 150 * NS_PER_MS, 0)
    sizes = np.diff(find_clock_steps(stamps, stepped).delays_ns) / NS_PER_MS
    assert sizes == pytest.approx([150], abs=3)


def test_messages_that_are_late_for_six_seconds_are_no_step():
    stamps, log_times = recorded()
    n = np.arange(2000)
    log_times = log_times + np.where((n >= 900) & (n < 1500), 200 * NS_PER_MS, 0)
    assert len(find_clock_steps(stamps, log_times).log_times_ns) == 0


def test_a_clock_that_drifts_by_200_ppm_does_not_step():
    stamps, log_times = recorded(duration_s=300)
    drift = ((stamps - START_NS) * 200e-6).astype(np.int64)
    assert len(find_clock_steps(stamps, log_times + drift).log_times_ns) == 0


def test_a_step_that_all_streams_share_is_left_alone():
    step = np.where(np.arange(2000) >= 900, 300 * NS_PER_MS, 0)
    streams = {name: recorded(seed=k) for k, name in enumerate(("/tf", "camera"))}
    both = {name: find_clock_steps(s, t + step) for name, (s, t) in streams.items()}
    assert all(len(s.log_times_ns) == 1 for s in both.values())
    assert all(len(s.log_times_ns) == 0 for s in drop_common_steps(both).values())
    one = both | {"camera": find_clock_steps(*streams["camera"])}
    assert len(drop_common_steps(one)["/tf"].log_times_ns) == 1


def test_stamps_of_a_stream_follow_the_logs_clock_over_a_step():
    """The MCS keeps its clock when that of log and camera is set forward by 0.3 s."""
    stamps, log_times = recorded()
    later = np.where(np.arange(2000) >= 900, 300 * NS_PER_MS, 0)
    streams = {
        "/tf": StreamTimes(stamps, log_times + later),
        "camera": StreamTimes(stamps + later, log_times + later),
    }
    clocks = match_streams_to_log(streams)
    taken = clocks["/tf"].message_times_ns(*streams["/tf"])
    assert abs(taken - streams["camera"].stamps_ns).max() < NS_PER_MS
    assert (clocks["camera"].message_times_ns(*streams["camera"]) == stamps + later).all()
    (step,) = clock_steps_json("/tf", clocks["/tf"].steps, int(log_times[0]))
    assert step["at_s"] == pytest.approx(9.3, abs=0.02)
    assert step["size_s"] == pytest.approx(0.3, abs=0.001)
    assert "/tf: log time minus stamp jumped by +300 ms at 9.3 s" in step["text"]
    assert "to_s: 8.8" in step["remedy"] and "from_s: 9.8" in step["remedy"]


def test_missing_stamps_stay_missing():
    stamps, log_times = recorded()
    log_times = log_times + np.where(np.arange(2000) >= 900, 300 * NS_PER_MS, 0)
    steps = find_clock_steps(stamps, log_times)
    stamps[[3, 950, 1500]] = -1
    assert (np.flatnonzero(steps.correct(stamps, log_times) == -1) == [3, 950, 1500]).all()
