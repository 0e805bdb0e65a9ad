"""What the fields of a lidar's clouds mean, found out of a few of them."""

from dataclasses import asdict, dataclass

from calib.io.status import OK, failure_status
from calib.sensors.lidar.clouds.beam_inference import BeamSource, infer_beams
from calib.sensors.lidar.clouds.point_time_inference import (
    DEFAULT_MAX_SCAN_NS,
    PointTime,
    infer_point_time,
)

MAX_SCAN_PERIOD_NS = 10**9  # from stamp to stamp: beyond that, clouds were left out of the log
NO_POINT_TIME_TEXT = (
    "each scan is taken as one moment: used only while everything rests, and the sensor's clock "
    "cannot be told from the motion capture's"
)


@dataclass(frozen=True)
class CloudLayout:
    """times.Time and rings.Ring of a lidar's clouds, None where they have none, and the time, ns,
    from scan to scan, 0 if unknown."""

    point_time: PointTime | None = None
    beams: BeamSource | None = None
    period_ns: int = 0

    def time_span_ns(self, dt):
        """First and last time, ns after the stamp, at which a scan with points at dt (n,) can have
        measured: a whole period to both sides where points have no time."""
        if self.point_time is None:
            period = self.period_ns or DEFAULT_MAX_SCAN_NS
            return -period, period
        return dt.min(), dt.max()

    def to_dict(self):
        return asdict(self)

    @classmethod
    def from_dict(cls, d):
        time, beams = d["point_time"], d["beams"]
        beams = beams and beams | {"elevation_deg": tuple(beams["elevation_deg"])}
        return cls(time and PointTime(**time), beams and BeamSource(**beams), d["period_ns"])


def infer_cloud_layout(samples, period_ns, point_time_config):
    """(Layout, words on {time, ring}, status) of a lidar from a few clouds (times.infer).

    period_ns: from stamp to stamp, ns, 0 if unknown. The status fails where the rig's point_time,
    asked, names what the clouds do not have.
    """
    period_ns = int(period_ns) if period_ns <= MAX_SCAN_PERIOD_NS else 0
    time, told = infer_point_time(samples, period_ns, point_time_config)
    ring, beams = infer_beams([c for c, _ in samples])
    status = OK
    if time is None and point_time_config:
        status = failure_status(
            "point_time does not fit the clouds",
            told,
            ", ".join(f"{k} {v}" for k, v in sorted(point_time_config.items())),
            "Correct point_time in the rig, or leave it out: it is inferred then.",
        )
    if time is None:
        told = f"no time of points ({told}): {NO_POINT_TIME_TEXT}"
    return CloudLayout(time, ring, period_ns), {"time": told, "ring": beams}, status
