"""When each point of a cloud was measured: drivers agree on neither field, unit nor origin.

The growth of the values shows their unit: times of a clock grow from scan to scan as fast as the
stamps, others within a scan, which takes about as long as from one stamp to the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from calib.geometry.units import NS_PER_S
from calib.io.status import MessageError
from calib.sensors.lidar.clouds.raw_cloud import RawCloud

NS_PER_UNIT = {"s": NS_PER_S, "ms": 10**6, "us": 10**3, "ns": 1}
TIME_ORIGIN_TEXTS = {
    "stamp": "after the stamp",
    "clock": "on the clock of the stamps",
    "first": "on a clock of their own, taken from the first point on, at the stamp",
    "last": "on a clock of their own, taken back from the last point, at the stamp",
}
# fmt: off
POINT_TIME_FIELDS = (
    "time", "t", "timestamp", "time_stamp", "offset_time", "ts", "lidar_sec", "timestamps",
    "stamps", "time_offset", "point_time", "time_increment",
)
# fmt: on
NANOSECOND_FIELDS = {"lidar_sec": "lidar_nsec"}  # seconds and the field of their nanoseconds
DEFAULT_MAX_SCAN_NS = 200_000_000  # duration of any scan, where stamps do not show it
MAX_SCAN_PERIODS = 1.5  # that a scan takes; below a thousandth of it the next unit is meant
MIN_EPOCH_TIME_S = 1e8  # of any clock that began in 1970, and more than any relative time
MAX_SAME_CLOCK_NS = NS_PER_S  # a clock less than this from the stamps is theirs
TAI_OFFSET_S = 37  # TAI is ahead of UTC by this


@dataclass(frozen=True)
class PointTime:
    """Field, unit (of NS_PER_UNIT) and origin (of TIME_ORIGIN_TEXTS) of the times of points."""

    field: str
    unit: str
    origin: str


class CloudSample(NamedTuple):
    """A cloud, and the time, ns, at which the log recorded it."""

    cloud: RawCloud
    log_time_ns: int


def point_times_ns(cloud: RawCloud, point_time: PointTime | None) -> np.ndarray:
    """Return the times (n,) of a cloud's points, ns after its stamp; zero if they have none.

    Raises MessageError if the cloud has no such field.
    """
    if point_time is None:
        return np.zeros(cloud.n_points, np.int64)
    required = {point_time.field, NANOSECOND_FIELDS.get(point_time.field, point_time.field)}
    if not required <= set(cloud.fields):
        raise MessageError(
            f"a cloud without its time, {point_time.field}: "
            f"its fields are {', '.join(cloud.fields)}"
        )
    ns = _field_to_ns(cloud, point_time.field, point_time.unit)
    if point_time.origin == "clock":
        return ns - cloud.stamp_ns
    if point_time.origin == "stamp" or not len(ns):
        return ns
    return ns - (ns.min() if point_time.origin == "first" else ns.max())


def _field_to_ns(cloud: RawCloud, field: str, unit: str) -> np.ndarray:
    """Return the values (n,) of a field, ns; those not finite or too large become the largest."""
    values = cloud.fields[field]
    if field in NANOSECOND_FIELDS:
        nanoseconds = cloud.fields[NANOSECOND_FIELDS[field]]
        return values.astype(np.int64) * NS_PER_UNIT["s"] + nanoseconds.astype(np.int64)
    if values.dtype.kind in "iu":
        return values.astype(np.int64) * NS_PER_UNIT[unit]
    most = 4e18 / NS_PER_UNIT[unit]
    values = np.clip(np.nan_to_num(values.astype(float), nan=most), -most, most)
    whole = np.floor(values)
    fraction_ns = np.rint((values - whole) * NS_PER_UNIT[unit]).astype(np.int64)
    return whole.astype(np.int64) * NS_PER_UNIT[unit] + fraction_ns


def infer_point_time(
    samples: Sequence[CloudSample], period_ns: int, point_time_config: dict[str, Any]
) -> tuple[PointTime | None, str]:
    """Infer the time of points, and describe it, or why there is none.

    samples: clouds in the order of their stamps; period_ns: from scan to scan, 0 if unknown;
    point_time_config: what the rig's point_time states of field, unit and origin.
    """
    available = samples[0].cloud.fields
    if "field" in point_time_config:
        fields = [point_time_config["field"]]
    else:
        fields = [f for f in POINT_TIME_FIELDS if f in available]
    rejections = []
    for field in fields:
        if field not in available or NANOSECOND_FIELDS.get(field, field) not in available:
            return None, f"no field {field}: there are {', '.join(available)}"
        time, text = _infer_field_time(samples, field, period_ns, point_time_config)
        if time is not None:
            return time, text
        rejections.append(text)
    return None, "; ".join(rejections) or f"none of the fields {', '.join(available)} is a time"


def _infer_field_time(
    samples: Sequence[CloudSample],
    field: str,
    known_period_ns: int,
    point_time_config: dict[str, Any],
) -> tuple[PointTime | None, str]:
    """Infer the time that one field holds, and describe it, or why its values are no times."""
    kind = samples[0].cloud.fields[field].dtype.name
    samples = [s for s in samples if len(s.cloud.fields[field])]
    values = [s.cloud.fields[field].astype(float) for s in samples]
    period_ns = known_period_ns or DEFAULT_MAX_SCAN_NS
    if not samples or not all(np.isfinite(v).all() for v in values):
        return None, f"{field} ({kind}) has values that are not finite"
    unit = point_time_config.get("unit") or _infer_unit(field, samples, values, period_ns)
    if unit is None:
        span, period_ms = np.median([np.ptp(v) for v in values]), period_ns / 1e6
        return None, f"{field} ({kind}) spans {span:.4g} in a scan, no time of {period_ms:.4g} ms"
    time = PointTime(field, unit, "stamp")
    dt = [point_times_ns(s.cloud, time) for s in samples]
    time = replace(
        time, origin=point_time_config.get("origin") or _infer_origin(samples, dt, period_ns)
    )
    dt = [point_times_ns(s.cloud, time) for s in samples]
    low, high = (round(np.median([f(d) for d in dt]) / 1e6, 1) + 0.0 for f in (np.min, np.max))
    text = f"{field} ({kind}), {unit} {TIME_ORIGIN_TEXTS[time.origin]}"
    text += " (point_time)" * bool(point_time_config) + f": {low} to {high} ms"
    text += f", {known_period_ns / 1e6:.1f} ms from scan to scan" * bool(known_period_ns)
    text += _describe_clock_difference(samples, time) + _describe_doubts(samples, dt, period_ns)
    return time, text


def _infer_unit(
    field: str, samples: Sequence[CloudSample], values: list[np.ndarray], period_ns: int
) -> str | None:
    """Return the unit of a field, or None if its values are no times."""
    if field in NANOSECOND_FIELDS:
        return "ns"
    first, span = [v.min() for v in values], np.median([np.ptp(v) for v in values])
    if not span > 0:
        return None
    elapsed_ns = samples[-1].cloud.stamp_ns - samples[0].cloud.stamp_ns
    growth = first[-1] - first[0]
    for unit, ns in NS_PER_UNIT.items():
        if elapsed_ns > 0 and growth > span / 2 and abs(growth * ns / elapsed_ns - 1) < 0.2:
            return unit
    # A single scan, or a clock that does not keep pace with the stamps.
    for unit, ns in NS_PER_UNIT.items():
        seconds = abs(first[0]) * ns / 1e9
        is_epoch = MIN_EPOCH_TIME_S < seconds < 100 * MIN_EPOCH_TIME_S
        if is_epoch and span < 1e-3 * abs(first[0]):
            return unit
    for unit, ns in NS_PER_UNIT.items():
        if MAX_SCAN_PERIODS / 1000 < span * ns / period_ns <= MAX_SCAN_PERIODS:
            return unit
    return None


def _infer_origin(
    samples: Sequence[CloudSample], times_ns: list[np.ndarray], period_ns: int
) -> str:
    """Return the origin of the times (n,) of each cloud."""
    if max(np.abs(t).max() for t in times_ns) <= MAX_SCAN_PERIODS * period_ns:
        return "stamp"
    ahead = np.median([t.min() - s.cloud.stamp_ns for t, s in zip(times_ns, samples, strict=True)])
    if abs(ahead) < MAX_SAME_CLOCK_NS:
        return "clock"
    # A log records a scan after its end: a scan recorded at its stamp was stamped at the end.
    delay = np.median([s.log_time_ns - s.cloud.stamp_ns for s in samples])
    return "last" if 0 <= delay < period_ns / 2 else "first"


def _describe_clock_difference(samples: Sequence[CloudSample], time: PointTime) -> str:
    """Describe how far a lidar's own clock is from the stamps."""
    if time.origin not in ("first", "last"):
        return ""
    ahead_ns = [
        _field_to_ns(s.cloud, time.field, time.unit).min() - s.cloud.stamp_ns for s in samples
    ]
    ahead_s = np.median(ahead_ns) / 1e9
    is_tai = abs(abs(ahead_s) - TAI_OFFSET_S) < 1
    tai = ": TAI for UTC, set the driver's offset" if is_tai else ""
    return f"; that clock is {ahead_s:+.3f} s from the stamps{tai}"


def _describe_doubts(samples: Sequence[CloudSample], dt: list[np.ndarray], period_ns: int) -> str:
    """Describe what contradicts the times (n,), ns after the stamp, of each cloud."""
    low, high = min(d.min() for d in dt), max(d.max() for d in dt)
    text = ""
    if high - low > MAX_SCAN_PERIODS * period_ns or max(-low, high) > MAX_SAME_CLOCK_NS:
        text += "; doubtful: no scan takes that long; see point_time"
    late_ns = np.median(
        [s.log_time_ns - s.cloud.stamp_ns - d.max() for d, s in zip(dt, samples, strict=True)]
    )
    if -MAX_SAME_CLOCK_NS < late_ns < -period_ns / 4:
        text += (
            f"; doubtful: the last points lie {-late_ns / 1e6:.0f} ms after the log recorded them, "
            "as if the stamp were the scan's end; if it is, write point_time: {origin: last}"
        )
    return text
