"""When each point of a cloud was measured: drivers agree on neither field, unit nor origin.

A unit shows by how the values grow: from scan to scan as fast as the stamps where they are times of
a clock, else within a scan, which takes about as long as from one stamp to the next.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.io.status import MessageError

NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
ORIGINS = {
    "stamp": "after the stamp",
    "clock": "on the clock of the stamps",
    "first": "on a clock of their own, taken from the first point on, at the stamp",
    "last": "on a clock of their own, taken back from the last point, at the stamp",
}
FIELDS = ("time", "t", "timestamp", "time_stamp", "offset_time", "ts", "lidar_sec", "timestamps",
          "stamps", "time_offset", "point_time", "time_increment")  # fmt: skip
SPLIT = {"lidar_sec": "lidar_nsec"}  # seconds and the field of their nanoseconds
USUAL_NS = 200_000_000  # that no scan takes longer, where stamps cannot tell
MOST = 1.5  # scan periods that a scan takes; a thousandth of that belongs to the next unit
ABSOLUTE = 1e8  # s of any clock that began in 1970, and more than any relative time
SAME_CLOCK_NS = 10**9  # a clock less than this from the stamps is theirs


@dataclass(frozen=True)
class Time:
    """Field, unit (of NS) and origin (of ORIGINS) of the times of points."""

    field: str
    unit: str
    origin: str


def after(cloud, time):
    """Times (n,) of a raw.Raw's points, ns after its stamp; zero where time is None.

    Raises MessageError where the cloud has no such field.
    """
    if time is None:
        return np.zeros(len(cloud.place[0]), np.int64)
    if not {time.field, SPLIT.get(time.field, time.field)} <= set(cloud.fields):
        raise MessageError(
            f"a cloud without its time, {time.field}: its fields are {', '.join(cloud.fields)}"
        )
    ns = _nanoseconds(cloud, time.field, time.unit)
    if time.origin == "clock":
        return ns - cloud.stamp
    if time.origin == "stamp" or not len(ns):
        return ns
    return ns - (ns.min() if time.origin == "first" else ns.max())


def _nanoseconds(cloud, field, unit):
    """Values (n,) of a field, ns; what is no number or does not fit is as far off as can be."""
    values = cloud.fields[field]
    if field in SPLIT:
        return values.astype(np.int64) * NS["s"] + cloud.fields[SPLIT[field]].astype(np.int64)
    if values.dtype.kind in "iu":
        return values.astype(np.int64) * NS[unit]
    most = 4e18 / NS[unit]
    values = np.clip(np.nan_to_num(values.astype(float), nan=most), -most, most)
    whole = np.floor(values)
    return whole.astype(np.int64) * NS[unit] + np.rint((values - whole) * NS[unit]).astype(np.int64)


def infer(samples, period, asked):
    """(Time or None, in words how it was found, or why there is none).

    samples: (raw.Raw, log time in ns) of clouds in the order of their stamps; period, ns, from
    scan to scan, 0 if unknown; asked: what the rig's point_time states of field, unit and origin.
    """
    known = samples[0][0].fields
    fields = [asked["field"]] if "field" in asked else [f for f in FIELDS if f in known]
    refused = []
    for field in fields:
        if field not in known or SPLIT.get(field, field) not in known:
            return None, f"no field {field}: there are {', '.join(known)}"
        time, words = _of_field(samples, field, period, asked)
        if time is not None:
            return time, words
        refused.append(words)
    return None, "; ".join(refused) or f"none of the fields {', '.join(known)} is a time"


def _of_field(samples, field, period, asked):
    """(Time, words) of one field; (None, why its values are no times)."""
    kind = samples[0][0].fields[field].dtype.name
    values = [c.fields[field].astype(float) for c, _ in samples if len(c.fields[field])]
    clouds = [(c, t) for c, t in samples if len(c.fields[field])]
    known, period = period, period or USUAL_NS
    if not clouds or not all(np.isfinite(v).all() for v in values):
        return None, f"{field} ({kind}) holds what is no number"
    unit = asked.get("unit") or _unit(field, clouds, values, period)
    if unit is None:
        span, most = np.median([np.ptp(v) for v in values]), period / 1e6
        return None, f"{field} ({kind}) spans {span:.4g} in a scan, no time of {most:.4g} ms"
    time = Time(field, unit, "stamp")
    dt = [after(c, time) for c, _ in clouds]
    origin = asked.get("origin") or _origin(clouds, dt, period)
    time = replace(time, origin=origin)
    dt = [after(c, time) for c, _ in clouds]
    low, high = (round(np.median([f(d) for d in dt]) / 1e6, 1) + 0.0 for f in (np.min, np.max))
    words = f"{field} ({kind}), {unit} {ORIGINS[origin]}"
    words += " (point_time)" * bool(asked)
    words += f": {low} to {high} ms" + f", {known / 1e6:.1f} ms from scan to scan" * bool(known)
    return time, words + _apart(origin, clouds, field, unit) + _doubts(clouds, dt, period)


def _unit(field, clouds, values, period):
    """The unit of a field, or None where its values are no times."""
    if field in SPLIT:
        return "ns"
    first, span = [v.min() for v in values], np.median([np.ptp(v) for v in values])
    if not span > 0:
        return None
    passed = clouds[-1][0].stamp - clouds[0][0].stamp
    grown = first[-1] - first[0]
    for unit, ns in NS.items():
        if passed > 0 and grown > span / 2 and abs(grown * ns / passed - 1) < 0.2:
            return unit
    # A single scan, or a clock that does not keep pace with the stamps.
    for unit, ns in NS.items():
        if ABSOLUTE < abs(first[0]) * ns / 1e9 < 100 * ABSOLUTE and span < 1e-3 * abs(first[0]):
            return unit
    fits = [u for u, ns in NS.items() if MOST / 1000 < span * ns / period <= MOST]
    return fits[0] if fits else None


def _origin(clouds, ns, period):
    """The origin of times ns (n,) of each cloud."""
    if max(np.abs(t).max() for t in ns) <= MOST * period:
        return "stamp"
    ahead = np.median([t.min() - c.stamp for t, (c, _) in zip(ns, clouds, strict=True)])
    if abs(ahead) < SAME_CLOCK_NS:
        return "clock"
    # A log cannot take a scan before its end: what it took at once was stamped there.
    waited = np.median([log_t - c.stamp for c, log_t in clouds])
    return "last" if 0 <= waited < period / 2 else "first"


def _apart(origin, clouds, field, unit):
    if origin not in ("first", "last"):
        return ""
    ahead = [_nanoseconds(c, field, unit).min() - c.stamp for c, _ in clouds]
    ahead = np.median(ahead) / 1e9
    tai = ": TAI for UTC, set the driver's offset" if abs(abs(ahead) - 37) < 1 else ""
    return f"; that clock is {ahead:+.3f} s from the stamps{tai}"


def _doubts(clouds, dt, period):
    """What speaks against the times found."""
    low, high = min(d.min() for d in dt), max(d.max() for d in dt)
    words = ""
    if high - low > MOST * period or max(-low, high) > SAME_CLOCK_NS:
        words += "; doubtful: no scan takes that long; see point_time"
    late = np.median([log_t - c.stamp - d.max() for d, (c, log_t) in zip(dt, clouds, strict=True)])
    if -SAME_CLOCK_NS < late < -period / 4:
        words += (
            f"; doubtful: the last points lie {-late / 1e6:.0f} ms after the log took them, as if "
            "the stamp were the scan's end; if it is, write point_time: {origin: last}"
        )
    return words
