"""The benchmark's section on what labs get wrong, as Markdown."""

import numpy as np

from benchmarking.lab_faults import lab_faults
from benchmarking.page.markdown import Section, both, digits, ratio, table

HEAD = ("fault", "error", "over clean", "σ reported over clean", "NEES/6", "verdict")
FOUND = ("fault", "quantity", "rms error", "σ reported", "goal")
OFF = ("fault", "error", "over clean", "verdict", "first reason")
COST = 1.2  # times the error of the clean log that a fault may leave
GOALS = {"ms": 0.5, "mm": 0.5, "°": 0.05}  # design's, of offsets and mounts
FAR_GOAL = 1.0  # ms, of an offset of 200 ms


def section(outcomes):
    """The Section on {(fault, on): [lab.Outcome] of its logs}."""
    faults = list(dict.fromkeys(fault for fault, _ in outcomes))
    count = len(next(iter(outcomes.values())))
    parts = {
        "logs": f"{count} log{'s' * (count > 1)}",
        "on": table(HEAD, [_row(outcomes, fault) for fault in faults]),
        "found": table(FOUND, [row for fault in faults for row in _found(outcomes, fault)]),
        "off": table(OFF, [_off(outcomes, fault) for fault in faults]),
        "cost": COST,
    }
    missed = [s for fault in faults for s in short_of(outcomes, fault)]
    return Section("What labs get wrong", TEXT.format(**parts), missed)


def rms(outcomes, what):
    """(mm, deg) over all sensors and logs of what = errors or sigma."""
    values = np.array([v for o in outcomes for v in getattr(o, what).values()])
    return tuple(np.sqrt(np.mean(values**2, axis=0)))


def _row(outcomes, fault):
    own, clean = outcomes[fault, True], outcomes[lab_faults.CLEAN, True]
    return [
        lab_faults.FAULTS[fault][0],
        both(rms(own, "errors")),
        ratio(rms(own, "errors"), rms(clean, "errors")),
        ratio(rms(own, "sigma"), rms(clean, "sigma")),
        digits(np.mean([v for o in own for v in o.nees.values()])),
        _verdicts(own),
    ]


def _verdicts(outcomes):
    return ", ".join(sorted({o.verdict for o in outcomes}))


def quantities(outcomes):
    """{quantity: (rms error, rms σ)} over the logs of a fault."""
    names = sorted({q for o in outcomes for q in o.found})
    return {
        q: tuple(
            np.sqrt(np.mean(np.square([o.found[q] for o in outcomes if q in o.found]), axis=0))
        )
        for q in names
    }


def goal(fault, quantity):
    """The goal of a quantity, in its own unit, or None."""
    unit = quantity.rsplit(", ", 1)[1]
    return FAR_GOAL if (fault, unit) == ("clock far", "ms") else GOALS.get(unit)


def _found(outcomes, fault):
    return [
        [lab_faults.FAULTS[fault][0], q, digits(error), digits(sigma), digits(goal(fault, q))]
        for q, (error, sigma) in quantities(outcomes[fault, True]).items()
    ]


def _off(outcomes, fault):
    own, clean = outcomes[fault, False], outcomes[lab_faults.CLEAN, False]
    return [
        lab_faults.FAULTS[fault][0],
        both(rms(own, "errors")),
        ratio(rms(own, "errors"), rms(clean, "errors")),
        _verdicts(own),
        own[0].reason.replace("|", "/") or "–",
    ]


def short_of(outcomes, fault):
    """Sentences on what one fault leaves beyond the goals."""
    title, out = lab_faults.FAULTS[fault][0], []
    own, clean = outcomes[fault, True], outcomes[lab_faults.CLEAN, True]
    over = np.divide(rms(own, "errors"), rms(clean, "errors"))
    if over.max() > COST:
        out.append(
            f"{title}: errors are {digits(over.max())} × those of the clean log, goal {COST}"
        )
    for q, (error, _) in quantities(own).items():
        if goal(fault, q) and not error <= goal(fault, q):
            out.append(f"{title}: {q}: {digits(error)}, goal {digits(goal(fault, q))}")
    quiet = [o for o in outcomes[fault, False] if o.verdict == "pass"]
    if fault != lab_faults.CLEAN and quiet:
        out.append(f"{title}: with the options off {len(quiet)} of the logs pass")
    return out


TEXT = """{logs} per line of a lidar and a camera, a board and a cylinder, 12 placements, through
the whole pipeline, with the noise of a laboratory. The same seed makes the same rig, noise and
placements, so that a line differs from the first by its fault alone.

{on}

* *error*, *σ reported*: root mean square over sensors and logs; *over clean*: divided by those of
  the first line, goal {cost} for errors. Where σ grows by more, the fault costs information:
  numbers that nobody knew beforehand are estimated from the same data.

What was found of the faults:

{found}

The same logs with `time_offset`, `target_alignment`, `intrinsics` and `beams` of `solve.estimate`
all `false`:

{off}"""
