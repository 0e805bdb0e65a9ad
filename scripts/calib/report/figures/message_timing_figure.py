"""Timing of the messages of all sensors: intervals between stamps, and delay of the log time."""

from typing import Any

import numpy as np

from calib.geometry.units import MS_PER_S, NS_PER_S
from calib.report.data.run_data import ReportRun
from calib.report.figures import figure_encoding
from calib.report.figures.captions import MESSAGE_TIMING
from calib.report.figures.figure_encoding import Drawing, cycle_colors
from calib.report.sections.recordings import select_sensor_stamps

MAX_POINTS = 1500  # per sensor


def draw_message_timing(run: ReportRun, session: str) -> Drawing | None:
    """Draw the timing of one session; None if no sensor has two messages."""
    frames = run.sessions[session].frames
    times = {n: select_sensor_stamps(frames, n) for n in run.sessions[session].streams}
    times = {n: stamps for n, stamps in times.items() if len(stamps[0]) > 1}
    if not times:
        return None
    start_ns = min(log_times_ns.min() for _, log_times_ns in times.values())
    fig, (intervals, delays) = figure_encoding.create_panels((1, 1), height=2.2)
    all_delays_ms = []
    for (name, (stamps_ns, log_times_ns)), color in zip(
        times.items(), cycle_colors(), strict=False
    ):
        step_ns = np.diff(stamps_ns)
        x = (log_times_ns - start_ns) / NS_PER_S
        delay_ms = (log_times_ns - stamps_ns) / NS_PER_S * MS_PER_S
        all_delays_ms.append(delay_ms)
        every = len(stamps_ns) // MAX_POINTS + 1
        style: dict[str, Any] = {
            "ms": 2.4,
            "mew": 0,
            "color": color,
            "alpha": 0.8,
            "rasterized": True,
        }
        relative = step_ns[::every] / max(np.median(step_ns), 1)
        intervals.plot(x[1::every], relative, ".", **style)
        delays.plot(x[::every], delay_ms[::every], ".", label=name, **style)
    intervals.set(xlabel="time, s", ylabel="over the median", ylim=(0, None))
    intervals.set_title("interval between stamps")
    delays.set(xlabel="time, s", ylabel="ms", title="log time after the stamp")
    delays.set_ylim(*_delay_limits_ms(np.concatenate(all_delays_ms)))
    delays.legend(loc="upper right", ncols=min(len(times), 3), markerscale=2.5)
    return figure_encoding.finish_drawing(
        fig,
        f"timing-{session}",
        label=f"Intervals and delays of the messages of session {session}",
        caption=MESSAGE_TIMING,
        column_span=0,
    )


def _delay_limits_ms(delay_ms: np.ndarray) -> tuple[float, float]:
    """Return the limits of the axis, with space for the legend above the delays (n,)."""
    span = np.ptp(delay_ms) + 0.1 * np.abs(delay_ms).max()
    return delay_ms.min() - 0.1 * span, delay_ms.max() + 0.4 * span
