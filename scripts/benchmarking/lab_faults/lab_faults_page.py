"""The section of the benchmark page on common faults of labs."""

from pathlib import Path

import numpy as np

from benchmarking.lab_faults.lab_faults import LAB_FAULTS, NO_FAULT, LabOutcome
from benchmarking.page.markdown import (
    PageSection,
    format_goal_ratio,
    format_markdown_table,
    format_mm_deg,
    format_two_digits,
    render_markdown,
)

PAGE_TEMPLATE = Path(__file__).with_suffix(".md.j2")
FAULT_COLUMNS = ("fault", "error", "over clean", "σ reported over clean", "NEES/6", "verdict")
QUANTITY_COLUMNS = ("fault", "quantity", "rms error", "σ reported", "goal")
DISABLED_COLUMNS = ("fault", "error", "over clean", "verdict", "first reason")
MAX_ERROR_RATIO = 1.2  # goal: pose error with a fault over that of the log without faults
QUANTITY_GOALS = {"ms": 0.5, "mm": 0.5, "°": 0.05}  # errors of time offsets and target mounts
LARGE_OFFSET_GOAL_MS = 1.0  # for a time offset of 200 ms


def build_lab_section(outcomes: dict[tuple[str, bool], list[LabOutcome]]) -> PageSection:
    """Return the section of the page on faults of labs.

    outcomes: of the logs of a fault, by (fault, whether the corrections are on).
    """
    faults = list(dict.fromkeys(fault for fault, _ in outcomes))
    count = len(next(iter(outcomes.values())))
    parts = {
        "logs": f"{count} log{'s' * (count > 1)}",
        "on": format_markdown_table(
            FAULT_COLUMNS, [_fault_row(outcomes, fault) for fault in faults]
        ),
        "found": format_markdown_table(
            QUANTITY_COLUMNS, [row for fault in faults for row in _quantity_rows(outcomes, fault)]
        ),
        "off": format_markdown_table(
            DISABLED_COLUMNS, [_disabled_row(outcomes, fault) for fault in faults]
        ),
        "cost": MAX_ERROR_RATIO,
    }
    missed = [s for fault in faults for s in check_lab_goals(outcomes, fault)]
    return PageSection("Faults of labs", render_markdown(PAGE_TEMPLATE, **parts), missed)


def compute_lab_rms(outcomes: list[LabOutcome], field_name: str) -> tuple[float, float]:
    """Return the RMS (mm, deg) over all sensors and logs of a field, `errors` or `sigma`."""
    values = np.array([v for o in outcomes for v in getattr(o, field_name).values()])
    mm, deg = np.sqrt(np.mean(values**2, axis=0))
    return mm, deg


def _fault_row(outcomes: dict[tuple[str, bool], list[LabOutcome]], fault: str) -> list[str]:
    own, clean = outcomes[fault, True], outcomes[NO_FAULT, True]
    return [
        LAB_FAULTS[fault][0],
        format_mm_deg(compute_lab_rms(own, "errors")),
        format_goal_ratio(compute_lab_rms(own, "errors"), compute_lab_rms(clean, "errors")),
        format_goal_ratio(compute_lab_rms(own, "sigma"), compute_lab_rms(clean, "sigma")),
        format_two_digits(float(np.mean([v for o in own for v in o.nees_ratio.values()]))),
        _join_verdicts(own),
    ]


def _join_verdicts(outcomes: list[LabOutcome]) -> str:
    return ", ".join(sorted({o.verdict for o in outcomes}))


def compute_quantity_rms(outcomes: list[LabOutcome]) -> dict[str, tuple[float, float]]:
    """Return the RMS error and RMS σ over the logs of a fault, by quantity."""
    names = sorted({q for o in outcomes for q in o.fault_errors})
    return {
        q: tuple(
            np.sqrt(
                np.mean(
                    np.square([o.fault_errors[q] for o in outcomes if q in o.fault_errors]), axis=0
                )
            )
        )
        for q in names
    }


def find_quantity_goal(fault: str, quantity: str) -> float | None:
    """Return the goal of a quantity in its unit, None if it has no goal."""
    unit = quantity.rsplit(", ", 1)[1]
    return (
        LARGE_OFFSET_GOAL_MS if (fault, unit) == ("clock far", "ms") else QUANTITY_GOALS.get(unit)
    )


def _quantity_rows(
    outcomes: dict[tuple[str, bool], list[LabOutcome]], fault: str
) -> list[list[str]]:
    return [
        [
            LAB_FAULTS[fault][0],
            q,
            format_two_digits(error),
            format_two_digits(sigma),
            format_two_digits(find_quantity_goal(fault, q)),
        ]
        for q, (error, sigma) in compute_quantity_rms(outcomes[fault, True]).items()
    ]


def _disabled_row(outcomes: dict[tuple[str, bool], list[LabOutcome]], fault: str) -> list[str]:
    own, clean = outcomes[fault, False], outcomes[NO_FAULT, False]
    return [
        LAB_FAULTS[fault][0],
        format_mm_deg(compute_lab_rms(own, "errors")),
        format_goal_ratio(compute_lab_rms(own, "errors"), compute_lab_rms(clean, "errors")),
        _join_verdicts(own),
        own[0].first_finding.replace("|", "/") or "–",
    ]


def check_lab_goals(outcomes: dict[tuple[str, bool], list[LabOutcome]], fault: str) -> list[str]:
    """Return a sentence for each goal that is missed with a fault."""
    title, out = LAB_FAULTS[fault][0], []
    own, clean = outcomes[fault, True], outcomes[NO_FAULT, True]
    ratio = np.divide(compute_lab_rms(own, "errors"), compute_lab_rms(clean, "errors"))
    if ratio.max() > MAX_ERROR_RATIO:
        out.append(
            f"{title}: errors are {format_two_digits(ratio.max())} × those of the clean log, "
            f"goal {MAX_ERROR_RATIO}"
        )
    for q, (error, _) in compute_quantity_rms(own).items():
        goal = find_quantity_goal(fault, q)
        if goal and not error <= goal:
            out.append(f"{title}: {q}: {format_two_digits(error)}, goal {format_two_digits(goal)}")
    passed = [o for o in outcomes[fault, False] if o.verdict == "pass"]
    if fault != NO_FAULT and passed:
        out.append(f"{title}: with the options off, {len(passed)} of the logs pass")
    return out
