"""Tables of many draws, of coverage and of full runs, and what they fall short of, as Markdown."""

from scipy.stats import binom

from benchmarking.accuracy.accuracy_cases import ENSEMBLE, HELD, ROWS, SINGLE
from benchmarking.accuracy.draw_statistics import LEVEL, band
from benchmarking.accuracy.error_metrics import goal
from benchmarking.page.markdown import both, digits, over, percent, ratio, table

DRAWN = ("case", "N", "draws", "RMS error", "reference", "without outlines", "RMS / reference")
DRAWN += ("goal", "RMS / goal", f"above {SINGLE:g} ×", "NEES/6 [band]", "of their mean")
DRAWN += ("95 % ellipsoids hold",)
COVERED = ("case", "draws", "sensor", "NEES over its degrees of freedom [band]", "held")
FULL = ("sensor", "runs", "RMS error", "σ reported", "NEES/6 [band]", "held")


def in_order(found):
    """[(row, N, Statistics)] of {(key, N): Statistics}, in the order of the rows."""
    return [
        (row, n, found[row.key, n]) for row in ROWS for n in row.counts if (row.key, n) in found
    ]


def drawn(found):
    """The table of {(key, N): Statistics}."""
    return table(DRAWN, [_drawn_row(*item) for item in in_order(found)])


def _drawn_row(row, n, s):
    most = goal(row, n, s)
    return [
        row.title,
        str(n),
        str(s.count) + (f" of {s.count + s.lost}" if s.lost else ""),
        both(s.rms),
        both(s.reference),
        both(s.bare),
        ratio(s.rms, s.reference),
        both(most),
        ratio(s.rms, most),
        f"{percent(s.beyond)} ({percent(s.usual)})",
        with_band(s.nees, s.count),
        digits(s.shift),
        percent(s.held),
    ]


def with_band(nees, count, size=6):
    """A mean of NEES over its degrees of freedom, with the band of honest ones, as text."""
    low, high = band(count, size)
    return f"{digits(nees)} [{digits(low)}, {digits(high)}]"


def covered(found):
    """The table of Coverages."""
    return table(
        COVERED,
        [
            [
                c.title,
                str(c.count),
                name,
                with_band(c.nees[name], c.count, size),
                percent(c.held[name]),
            ]
            for c in found
            for name, size in c.size.items()
        ],
    )


def full(found):
    """The table of {sensor: Statistics} of full runs, whose reference is σ as reported."""
    return table(
        FULL,
        [
            [name, str(s.count), both(s.rms), both(s.reference), with_band(s.nees, s.count)]
            + [percent(s.held)]
            for name, s in sorted(found.items())
        ],
    )


def short_of(found, coverages, runs):
    """Sentences on what the three tables do not reach."""
    out = [s for item in in_order(found) for s in _short(*item)]
    for c in coverages:
        for name, size in c.size.items():
            where = f"observations as modelled, {c.title}, {name}"
            out += dishonest(where, c.nees[name], c.count, size)
            low, high = held_band(c.count)
            if not low <= c.held[name] <= high:
                ends = f"{percent(low)} to {percent(high)}"
                out.append(f"{where}: ellipsoids hold {percent(c.held[name])}, goal {ends}")
    for name, s in sorted(runs.items()):
        where = f"full runs, {name}"
        out += lost(where, s) + dishonest(where, s.nees, s.count)
    return out


def held_band(count):
    """HELD, or where that is wider, as with few draws, what chance does to an honest share."""
    low, high = binom.ppf([(1 - LEVEL) / 2, (1 + LEVEL) / 2], count, LEVEL) / count
    return min(HELD[0], low), max(HELD[1], high)


def _short(row, n, s):
    where = f"{row.title}, N = {n}, {s.count} draws"
    own = "" if row.goal else f" ({ENSEMBLE} × the reference)"
    out = lost(where, s) + over(where, s.rms, goal(row, n, s), own)
    if row.goal is None and s.beyond > 0:
        out.append(
            f"{where}: {percent(s.beyond)} err by more than {SINGLE:g} × the reference, one by "
            f"{digits(s.worst)} ×; of an efficient estimator {percent(s.usual)} would"
        )
    return out + dishonest(where, s.nees, s.count)


def lost(where, s):
    """A sentence on draws without a pose, if there are any."""
    return [f"{where}: {s.lost} of {s.count + s.lost} without a pose"] if s.lost else []


def dishonest(where, nees, count, size=6):
    """A sentence on a NEES outside its band, if it is."""
    low, high = band(count, size)
    if low <= nees <= high:
        return []
    ends = f"{digits(low)} to {digits(high)}"
    return [f"{where}: NEES over its degrees of freedom is {digits(nees)}, of an honest σ {ends}"]
