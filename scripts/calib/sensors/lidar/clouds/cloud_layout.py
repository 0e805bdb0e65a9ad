"""What the fields of a lidar's clouds mean, inferred from a few of them."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from calib.geometry.units import NS_PER_S
from calib.io.status import OK, Status, failure_status
from calib.sensors.lidar.clouds.beam_inference import BeamSource, infer_beams
from calib.sensors.lidar.clouds.point_time_inference import (
    DEFAULT_MAX_SCAN_NS,
    CloudSample,
    PointTime,
    infer_point_time,
)

MAX_SCAN_PERIOD_NS = NS_PER_S  # from stamp to stamp: beyond that, clouds are missing in the log
NO_POINT_TIME_TEXT = (
    "scans are used only while nothing moves, and the time offset of the sensor cannot be estimated"
)


@dataclass(frozen=True)
class CloudLayout:
    """Time and beam of the points of a lidar's clouds, None if they have none.

    period_ns: from scan to scan, 0 if unknown.
    """

    point_time: PointTime | None = None
    beams: BeamSource | None = None
    period_ns: int = 0

    def time_span_ns(self, dt: np.ndarray) -> tuple[int, int]:
        """Return the first and last time, ns after the stamp, of a scan with points at dt (n,).

        A whole period to both sides if points have no time.
        """
        if self.point_time is None:
            period = self.period_ns or DEFAULT_MAX_SCAN_NS
            return -period, period
        return dt.min(), dt.max()

    def to_dict(self) -> dict[str, Any]:
        """Return the layout as a block for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, d: dict[str, Any]) -> "CloudLayout":
        """Make the layout of a block of to_dict."""
        time, beams = d["point_time"], d["beams"]
        beams = beams and beams | {"elevation_deg": tuple(beams["elevation_deg"])}
        return cls(time and PointTime(**time), beams and BeamSource(**beams), d["period_ns"])


def infer_cloud_layout(
    samples: Sequence[CloudSample], period_ns: float, point_time_config: dict[str, Any]
) -> tuple[CloudLayout, dict[str, str], Status]:
    """Infer the layout of a lidar's clouds, and describe its time and ring.

    samples: a few clouds, in the order of their stamps; period_ns: from stamp to stamp, 0 if
    unknown; point_time_config: the rig's point_time. The status fails if point_time does not fit
    the clouds.
    """
    period_ns = int(period_ns) if period_ns <= MAX_SCAN_PERIOD_NS else 0
    time, time_text = infer_point_time(samples, period_ns, point_time_config)
    beams, beams_text = infer_beams([c for c, _ in samples])
    status = OK
    if time is None and point_time_config:
        status = failure_status(
            "point_time does not fit the clouds",
            time_text,
            ", ".join(f"{k} {v}" for k, v in sorted(point_time_config.items())),
            "Correct point_time in the rig, or leave it out: it is then inferred.",
        )
    if time is None:
        time_text = f"points have no time stamps ({time_text}): {NO_POINT_TIME_TEXT}"
    layout = CloudLayout(time, beams, period_ns)
    return layout, {"time": time_text, "ring": beams_text}, status
