"""When each point of a cloud was measured: drivers agree on neither field, unit nor origin.

A unit shows by how the values grow: from scan to scan as fast as the stamps where they are times of
a clock, else within a scan, which takes about as long as from one stamp to the next.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.geometry.units import NS_PER_S
from calib.io.status import MessageError

NS_PER_UNIT = {"s": NS_PER_S, "ms": 10**6, "us": 10**3, "ns": 1}
TIME_ORIGIN_TEXTS = {
    "stamp": "after the stamp",
    "clock": "on the clock of the stamps",
    "first": "on a clock of their own, taken from the first point on, at the stamp",
    "last": "on a clock of their own, taken back from the last point, at the stamp",
}
POINT_TIME_FIELDS = ("time", "t", "timestamp", "time_stamp", "offset_time", "ts", "lidar_sec", "timestamps",
          "stamps", "time_offset", "point_time", "time_increment")  # fmt: skip
NANOSECOND_FIELDS = {"lidar_sec": "lidar_nsec"}  # seconds and the field of their nanoseconds
DEFAULT_MAX_SCAN_NS = 200_000_000  # that no scan takes longer, where stamps cannot tell
MAX_SCAN_PERIODS = (
    1.5  # scan periods that a scan takes; a thousandth of that belongs to the next unit
)
MIN_EPOCH_TIME_S = 1e8  # s of any clock that began in 1970, and more than any relative time
MAX_SAME_CLOCK_NS = NS_PER_S  # a clock less than this from the stamps is theirs


@dataclass(frozen=True)
class PointTime:
    """Field, unit (of NS) and origin (of ORIGINS) of the times of points."""

    field: str
    unit: str
    origin: str


def point_times_ns(cloud, point_time):
    """Times (n,) of a raw.Raw's points, ns after its stamp; zero where time is None.

    Raises MessageError where the cloud has no such field.
    """
    if point_time is None:
        return np.zeros(len(cloud.grid_index[0]), np.int64)
    if not {point_time.field, NANOSECOND_FIELDS.get(point_time.field, point_time.field)} <= set(
        cloud.fields
    ):
        raise MessageError(
            f"a cloud without its time, {point_time.field}: its fields are {', '.join(cloud.fields)}"
        )
    ns = _field_to_ns(cloud, point_time.field, point_time.unit)
    if point_time.origin == "clock":
        return ns - cloud.stamp_ns
    if point_time.origin == "stamp" or not len(ns):
        return ns
    return ns - (ns.min() if point_time.origin == "first" else ns.max())


def _field_to_ns(cloud, field, unit):
    """Values (n,) of a field, ns; what is no number or does not fit is as far off as can be."""
    values = cloud.fields[field]
    if field in NANOSECOND_FIELDS:
        return values.astype(np.int64) * NS_PER_UNIT["s"] + cloud.fields[
            NANOSECOND_FIELDS[field]
        ].astype(np.int64)
    if values.dtype.kind in "iu":
        return values.astype(np.int64) * NS_PER_UNIT[unit]
    most = 4e18 / NS_PER_UNIT[unit]
    values = np.clip(np.nan_to_num(values.astype(float), nan=most), -most, most)
    whole = np.floor(values)
    return whole.astype(np.int64) * NS_PER_UNIT[unit] + np.rint(
        (values - whole) * NS_PER_UNIT[unit]
    ).astype(np.int64)


def infer_point_time(samples, period_ns, point_time_config):
    """(Time or None, in words how it was found, or why there is none).

    samples: (raw.Raw, log time in ns) of clouds in the order of their stamps; period, ns, from
    scan to scan, 0 if unknown; point_time_config: what the rig's point_time states of field, unit and origin.
    """
    known = samples[0][0].fields
    fields = (
        [point_time_config["field"]]
        if "field" in point_time_config
        else [f for f in POINT_TIME_FIELDS if f in known]
    )
    refused = []
    for field in fields:
        if field not in known or NANOSECOND_FIELDS.get(field, field) not in known:
            return None, f"no field {field}: there are {', '.join(known)}"
        time, words = _infer_field_time(samples, field, period_ns, point_time_config)
        if time is not None:
            return time, words
        refused.append(words)
    return None, "; ".join(refused) or f"none of the fields {', '.join(known)} is a time"


def _infer_field_time(samples, field, period_ns, point_time_config):
    """(Time, words) of one field; (None, why its values are no times)."""
    kind = samples[0][0].fields[field].dtype.name
    values = [c.fields[field].astype(float) for c, _ in samples if len(c.fields[field])]
    clouds = [(c, t) for c, t in samples if len(c.fields[field])]
    known, period_ns = period_ns, period_ns or DEFAULT_MAX_SCAN_NS
    if not clouds or not all(np.isfinite(v).all() for v in values):
        return None, f"{field} ({kind}) holds what is no number"
    unit = point_time_config.get("unit") or _infer_unit(field, clouds, values, period_ns)
    if unit is None:
        span, most = np.median([np.ptp(v) for v in values]), period_ns / 1e6
        return None, f"{field} ({kind}) spans {span:.4g} in a scan, no time of {most:.4g} ms"
    time = PointTime(field, unit, "stamp")
    dt = [point_times_ns(c, time) for c, _ in clouds]
    origin = point_time_config.get("origin") or _infer_origin(clouds, dt, period_ns)
    time = replace(time, origin=origin)
    dt = [point_times_ns(c, time) for c, _ in clouds]
    low, high = (round(np.median([f(d) for d in dt]) / 1e6, 1) + 0.0 for f in (np.min, np.max))
    words = f"{field} ({kind}), {unit} {TIME_ORIGIN_TEXTS[origin]}"
    words += " (point_time)" * bool(point_time_config)
    words += f": {low} to {high} ms" + f", {known / 1e6:.1f} ms from scan to scan" * bool(known)
    return time, words + _describe_clock_difference(origin, clouds, field, unit) + _describe_doubts(
        clouds, dt, period_ns
    )


def _infer_unit(field, clouds, values, period):
    """The unit of a field, or None where its values are no times."""
    if field in NANOSECOND_FIELDS:
        return "ns"
    first, span = [v.min() for v in values], np.median([np.ptp(v) for v in values])
    if not span > 0:
        return None
    passed = clouds[-1][0].stamp_ns - clouds[0][0].stamp_ns
    grown = first[-1] - first[0]
    for unit, ns in NS_PER_UNIT.items():
        if passed > 0 and grown > span / 2 and abs(grown * ns / passed - 1) < 0.2:
            return unit
    # A single scan, or a clock that does not keep pace with the stamps.
    for unit, ns in NS_PER_UNIT.items():
        if MIN_EPOCH_TIME_S < abs(
            first[0]
        ) * ns / NS_PER_S < 100 * MIN_EPOCH_TIME_S and span < 1e-3 * abs(first[0]):
            return unit
    fits = [
        u
        for u, ns in NS_PER_UNIT.items()
        if MAX_SCAN_PERIODS / 1000 < span * ns / period <= MAX_SCAN_PERIODS
    ]
    return fits[0] if fits else None


def _infer_origin(clouds, ns, period):
    """The origin of times ns (n,) of each cloud."""
    if max(np.abs(t).max() for t in ns) <= MAX_SCAN_PERIODS * period:
        return "stamp"
    ahead = np.median([t.min() - c.stamp_ns for t, (c, _) in zip(ns, clouds, strict=True)])
    if abs(ahead) < MAX_SAME_CLOCK_NS:
        return "clock"
    # A log cannot take a scan before its end: what it took at once was stamped there.
    waited = np.median([log_t - c.stamp_ns for c, log_t in clouds])
    return "last" if 0 <= waited < period / 2 else "first"


def _describe_clock_difference(origin, clouds, field, unit):
    if origin not in ("first", "last"):
        return ""
    ahead = [_field_to_ns(c, field, unit).min() - c.stamp_ns for c, _ in clouds]
    ahead = np.median(ahead) / NS_PER_S
    tai = ": TAI for UTC, set the driver's offset" if abs(abs(ahead) - 37) < 1 else ""
    return f"; that clock is {ahead:+.3f} s from the stamps{tai}"


def _describe_doubts(clouds, dt, period):
    """What speaks against the times found."""
    low, high = min(d.min() for d in dt), max(d.max() for d in dt)
    words = ""
    if high - low > MAX_SCAN_PERIODS * period or max(-low, high) > MAX_SAME_CLOCK_NS:
        words += "; doubtful: no scan takes that long; see point_time"
    late = np.median(
        [log_t - c.stamp_ns - d.max() for d, (c, log_t) in zip(dt, clouds, strict=True)]
    )
    if -MAX_SAME_CLOCK_NS < late < -period / 4:
        words += (
            f"; doubtful: the last points lie {-late / 1e6:.0f} ms after the log took them, as if "
            "the stamp were the scan's end; if it is, write point_time: {origin: last}"
        )
    return words
