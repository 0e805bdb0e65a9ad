"""When every sensor's messages came: intervals between stamps, and how late the log took them."""

import numpy as np

from calib.geometry.units import MS_PER_S, NS_PER_S
from calib.report.figures import svg_plots
from calib.report.figures.captions import MESSAGE_TIMING
from calib.report.figures.svg_plots import COLOR_CYCLE
from calib.report.sections.recording_audit import select_sensor_stamps

MAX_POINTS = 1500  # of a sensor


def draw_message_timing(run, session):
    """The Drawing of one session; None where no sensor sent two messages."""
    found = {n: select_sensor_stamps(run, session, n) for n in run.sessions[session].streams}
    found = {n: (t, log_t) for n, (t, log_t) in found.items() if len(t) > 1}
    if not found:
        return None
    zero = min(log_t.min() for _, log_t in found.values())
    fig, (intervals, delays) = svg_plots.create_panels((1, 1), height=2.2)
    for (name, (t, log_t)), colour in zip(found.items(), COLOR_CYCLE * 9, strict=False):
        step = np.diff(t)
        x = (log_t - zero) / NS_PER_S
        every = len(t) // MAX_POINTS + 1
        style = dict(ms=2.4, mew=0, color=colour, alpha=0.8, rasterized=True)
        intervals.plot(x[1::every], step[::every] / max(np.median(step), 1), ".", **style)
        delays.plot(
            x[::every], ((log_t - t) / NS_PER_S * MS_PER_S)[::every], ".", label=name, **style
        )
    intervals.set(xlabel="time, s", ylabel="over the median", ylim=(0, None))
    intervals.set_title("interval between stamps")
    delays.set(xlabel="time, s", ylabel="ms", title="log time after the stamp")
    late = np.concatenate([(log_t - t) / NS_PER_S * MS_PER_S for t, log_t in found.values()])
    room = np.ptp(late) + 0.1 * np.abs(late).max()
    delays.set_ylim(late.min() - 0.1 * room, late.max() + 0.4 * room)
    delays.legend(loc="upper right", ncols=min(len(found), 3), markerscale=2.5)
    label = f"Intervals and delays of the messages of session {session}"
    return svg_plots.finish_drawing(fig, f"intake-{session}", label, MESSAGE_TIMING, column_span=0)
