"""Numbers and tables as the benchmark's page writes them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import float64

ERROR_UNITS = (" mm", "°")


class PageSection(NamedTuple):
    """A part of the page: its title, its Markdown, and sentences on what it does not reach."""

    title: str
    text: str
    missed_goals: list[str]


def format_two_digits(value: float | None) -> str:
    """x to two significant digits, without an exponent; a dash for nothing."""
    if value is None or not np.isfinite(value):
        return "–"
    return np.format_float_positional(value, precision=2, fractional=False, trim="-")


def format_mm_deg(error_mm_deg: tuple[float, float] | None) -> str:
    """(mm, deg) as text."""
    if error_mm_deg is None or not np.all(np.isfinite(error_mm_deg)):
        return "–"
    return " ".join(
        format_two_digits(x) + unit for x, unit in zip(error_mm_deg, ERROR_UNITS, strict=True)
    )


def format_markdown_table(
    head: Sequence[str],
    rows: list[list[str]],
) -> str:
    """A Markdown table of texts."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def format_goal_ratio(error: tuple[float, float], goal: tuple[float, float]) -> str:
    """error / goal of (mm, deg) as text."""
    both_known = np.all(np.isfinite([error, goal]))
    return " ".join(format_two_digits(x) for x in np.divide(error, goal)) if both_known else "–"


def format_share_percent(share: float | float64) -> str:
    """A share as text, in percent."""
    return f"{100 * share:.3g} %"


def check_error_goal(
    case_label: str, error: tuple[float, float], goal: tuple[float, float], goal_note: str = ""
) -> list[str | Any]:
    """Sentences on what of `got` (mm, deg) is above the goal (mm, deg); goal_note: what that goal
    is."""
    out = []
    for value, most, unit in zip(error, goal, ERROR_UNITS, strict=True):
        if not value <= most:
            out.append(
                f"{case_label}: {format_two_digits(value)}{unit} is "
                f"{format_two_digits(value / most)} × the goal, "
                f"{format_two_digits(most)}{unit}{goal_note}"
            )
    return out
