"""Members, rejected measurements and their statistics, from residuals.parquet."""

import numpy as np

from calib.estimation.residuals.residual_registry import KINDS
from calib.io import parquet_tables
from calib.report import number_format
from calib.verdict import findings

BEYOND = 3.0
NORMAL_BEYOND = 0.0026998  # share of N(0, 1) beyond 3 σ
DOWN_WEIGHTED = 0.5
MEANING = {
    "cap": "distances of returns from a flat end of the cylinder",
    "corner": "pattern corners, u and v",
    "edge": "angles between outline crossings and the outline",
    "limb": "distances of contour points from the cylinder’s limb",
    "point": "distances of returns from the nearest template points",
    "silhouette": "distances of contour points from the template’s outline",
    "surface": "distances of returns from the surface",
    "vertex": "distances of a board’s corners from where they should be",
}
PRINTED = {"px": ("px", 1.0), "m": ("mm", 1e3), "rad": ("°", np.degrees(1.0))}


def unit(kind):
    """(unit, factor from SI or px) in which residuals of a kind are printed."""
    return PRINTED[KINDS[kind].UNIT]


def lengths(kinds):
    """Columns of the kind of length, m, of {kind: columns} that counts the most; None without."""
    found = [c for k, c in kinds.items() if KINDS[k].UNIT == "m"]
    return max(found, key=lambda c: len(c["weight"]), default=None)


def of(run, sensor):
    """{kind: columns} of one sensor."""
    return run.by_sensor.get(sensor, {})


def members(columns):
    """The rows that took part in the solve."""
    return parquet_tables.select(columns, np.asarray(columns["weight"]) > 0)


def components(columns):
    """(n, 1 or 2) residuals: pixels have two components, distances and angles one."""
    value = columns["value"]
    return value if np.any(value[:, 1] != 0) else value[:, :1]


def normalised(columns):
    """(n, 1 or 2) residuals in units of their own σ."""
    return components(columns) / columns["sigma"][:, None]


def rms(values):
    """Root mean square, or None of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else None


def signed(r):
    """Whether residuals can be negative; lengths cannot, and follow no normal."""
    return bool(np.any(np.asarray(r) < 0))


def beyond(r):
    """How many of the normalised residuals lie beyond 3 σ, and how many of a normal would."""
    return int(np.sum(np.abs(r) > BEYOND)), NORMAL_BEYOND * np.size(r)


def overview(run, sensor):
    """One row per kind of measurement: how many, how large, how many beyond 3 σ or left out."""
    rows = []
    for kind, columns in of(run, sensor).items():
        used = members(columns)
        n, all_rows = len(used["weight"]), len(columns["weight"])
        name, scale = unit(kind)
        r = normalised(used) if n else np.zeros((0, 1))
        out, expected = beyond(r)
        told = f" (normal: {number_format.number(expected, 2)})"
        rows.append(
            {
                "kind": kind,
                "meaning": MEANING.get(kind, ""),
                "handed": number_format.count(all_rows),
                "used": number_format.count(n),
                "left_out": number_format.count(all_rows - n),
                "down": number_format.count(int(np.sum(used["weight"] < DOWN_WEIGHTED))),
                "rms": f"{number_format.number(_norm_rms(used) * scale)} {name}"
                if n
                else number_format.DASH,
                "rms_sigma": number_format.fixed(rms(r), 2),
                "beyond": number_format.count(out) + told * signed(r),
            }
        )
    return rows


def rejected(run, sensor):
    """(candidates, rejected, share, level) of one sensor: what geometry admits, the gate refused.

    None without a candidate.
    """
    found = run.calibration["sensors"][sensor]
    share, members_ = found["rejected"], found["points"]
    if share >= 1 or not members_:
        return None
    candidates = round(members_ / (1 - share))
    level = findings.level(share, run.verdict["limits"], "rejected")
    n = candidates - members_
    return {
        "of": number_format.count(candidates),
        "n": number_format.count(n),
        "share": number_format.percent(share),
    } | {"level": level}


def _norm_rms(columns):
    return float(np.sqrt(np.mean(np.sum(components(columns) ** 2, 1))))


def by_placement(columns):
    """[(session, placement, members, rms in σ)] in order; columns hold members."""
    r = normalised(columns)
    out = []
    for rows in groups(columns["session"], columns["placement"]):
        key = str(columns["session"][rows[0]]), int(columns["placement"][rows[0]])
        out.append((*key, len(rows), rms(r[rows])))
    return out


def groups(first, second):
    """Rows of each pair of values of two arrays (n,), n > 0, in order of the pairs."""
    order = np.lexsort((second, first))
    a, b = first[order], second[order]
    starts = np.flatnonzero((a[1:] != a[:-1]) | (b[1:] != b[:-1])) + 1
    return np.split(order, starts)


def view_scores(columns_by_kind):
    """{(session, view): (placement, rms in σ, members)} over all kinds of one sensor."""
    gathered = {}
    for columns in columns_by_kind.values():
        used = members(columns)
        if not len(used["weight"]):
            continue
        r = normalised(used)
        for rows in groups(used["session"], used["view"]):
            at = str(used["session"][rows[0]]), int(used["view"][rows[0]])
            gathered.setdefault(at, (int(used["placement"][rows[0]]), []))[1].append(
                r[rows].ravel()
            )
    parts = {k: (p, np.concatenate(v)) for k, (p, v) in gathered.items()}
    return {k: (p, rms(v), len(v)) for k, (p, v) in sorted(parts.items())}


def noise(run):
    """Rows of configured against re-estimated σ by sensor and kind."""
    rows = []
    for sensor, kinds in sorted(run.calibration["noise"]["sensors"].items()):
        for kind, sigma in sorted(kinds.items()):
            name, scale = unit(kind)
            given = configured(run, sensor, kind)
            rows.append(
                {
                    "sensor": sensor,
                    "kind": kind,
                    "configured": number_format.number(None if given is None else given * scale),
                    "found": number_format.number(sigma * scale),
                    "ratio": number_format.number(None if given is None else sigma / given),
                    "unit": name,
                }
            )
    return rows


def configured(run, sensor, kind):
    """Median σ that the keypoints of one kind came with, or None without any."""
    parts = []
    for session in run.sessions.values():
        if sensor in session.streams:
            k = session.streams[sensor].keypoints
            parts.append(np.asarray(k["sigma"])[np.asarray(k["kind"], str) == kind])
    sigma = np.concatenate(parts) if parts else np.zeros(0)
    return float(np.median(sigma)) if len(sigma) else None
