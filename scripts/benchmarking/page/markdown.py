"""Numbers and tables as the benchmark's page writes them."""

from typing import NamedTuple

import numpy as np

ERROR_UNITS = (" mm", "°")


class PageSection(NamedTuple):
    """A part of the page: its title, its Markdown, and sentences on what it does not reach."""

    title: str
    text: str
    missed_goals: list


def format_two_digits(value):
    """x to two significant digits, without an exponent; a dash for nothing."""
    if value is None or not np.isfinite(value):
        return "–"
    return np.format_float_positional(value, precision=2, fractional=False, trim="-")


def format_mm_deg(error_mm_deg):
    """(mm, deg) as text."""
    if error_mm_deg is None or not np.all(np.isfinite(error_mm_deg)):
        return "–"
    return " ".join(
        format_two_digits(x) + unit for x, unit in zip(error_mm_deg, ERROR_UNITS, strict=True)
    )


def format_markdown_table(head, rows):
    """A Markdown table of texts."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def format_goal_ratio(error, goal):
    """error / goal of (mm, deg) as text."""
    both_known = np.all(np.isfinite([error, goal]))
    return " ".join(format_two_digits(x) for x in np.divide(error, goal)) if both_known else "–"


def format_share_percent(share):
    """A share as text, in percent."""
    return f"{100 * share:.3g} %"


def check_error_goal(case_label, error, goal, goal_note=""):
    """Sentences on what of `got` (mm, deg) is above the goal (mm, deg); goal_note: what that goal is."""
    out = []
    for value, most, unit in zip(error, goal, ERROR_UNITS, strict=True):
        if not value <= most:
            out.append(
                f"{case_label}: {format_two_digits(value)}{unit} is {format_two_digits(value / most)} × the goal, "
                f"{format_two_digits(most)}{unit}{goal_note}"
            )
    return out
