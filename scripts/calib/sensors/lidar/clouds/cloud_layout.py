"""What the fields of a lidar's clouds mean, found out of a few of them."""

from dataclasses import asdict, dataclass

from calib.io.status import OK, failed
from calib.sensors.lidar.clouds import beam_inference, point_time_inference

LONGEST_NS = 10**9  # from stamp to stamp: beyond that, clouds were left out of the log
UNTIMED = (
    "each scan is taken as one moment: used only while everything rests, and the sensor's clock "
    "cannot be told from the motion capture's"
)


@dataclass(frozen=True)
class Layout:
    """times.Time and rings.Ring of a lidar's clouds, None where they have none, and the time, ns,
    from scan to scan, 0 if unknown."""

    time: point_time_inference.Time | None = None
    ring: beam_inference.Ring | None = None
    period: int = 0

    def reach(self, dt):
        """First and last time, ns after the stamp, at which a scan with points at dt (n,) can have
        measured: a whole period to both sides where points have no time."""
        if self.time is None:
            period = self.period or point_time_inference.USUAL_NS
            return -period, period
        return dt.min(), dt.max()

    def to_dict(self):
        return asdict(self)

    @classmethod
    def from_dict(cls, d):
        time, ring = d["time"], d["ring"]
        ring = ring and ring | {"elevation_deg": tuple(ring["elevation_deg"])}
        return cls(
            time and point_time_inference.Time(**time),
            ring and beam_inference.Ring(**ring),
            d["period"],
        )


def infer(samples, period, asked):
    """(Layout, words on {time, ring}, status) of a lidar from a few clouds (times.infer).

    period: from stamp to stamp, ns, 0 if unknown. The status fails where the rig's point_time,
    asked, names what the clouds do not have.
    """
    period = int(period) if period <= LONGEST_NS else 0
    time, told = point_time_inference.infer(samples, period, asked)
    ring, beams = beam_inference.infer([c for c, _ in samples])
    status = OK
    if time is None and asked:
        status = failed(
            "point_time does not fit the clouds",
            told,
            ", ".join(f"{k} {v}" for k, v in sorted(asked.items())),
            "Correct point_time in the rig, or leave it out: it is inferred then.",
        )
    if time is None:
        told = f"no time of points ({told}): {UNTIMED}"
    return Layout(time, ring, period), {"time": told, "ring": beams}, status
