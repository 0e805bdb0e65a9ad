"""Numbers and tables as text of the benchmark page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import numpy as np
from numpy import float64

ERROR_UNITS = (" mm", "°")


class PageSection(NamedTuple):
    """A section of the page: title, Markdown text, and a sentence for each missed goal."""

    title: str
    text: str
    missed_goals: list[str]


def render_markdown(template: Path, **values: Any) -> str:
    """Return a Markdown template with its values; raise UndefinedError if one is missing."""
    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # Markdown, not HTML
    )
    return environment.from_string(template.read_text()).render(values)


def format_two_digits(value: float | None) -> str:
    """Return a number with two significant digits and without exponent; a dash for None or NaN."""
    if value is None or not np.isfinite(value):
        return "–"
    return np.format_float_positional(value, precision=2, fractional=False, trim="-")


def format_mm_deg(error_mm_deg: tuple[float, float] | None) -> str:
    """Return (mm, deg) as text; a dash for None or NaN."""
    if error_mm_deg is None or not np.all(np.isfinite(error_mm_deg)):
        return "–"
    return " ".join(
        format_two_digits(x) + unit for x, unit in zip(error_mm_deg, ERROR_UNITS, strict=True)
    )


def format_markdown_table(
    head: Sequence[str],
    rows: list[list[str]],
) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def format_goal_ratio(error: tuple[float, float], goal: tuple[float, float]) -> str:
    """Return error / goal of (mm, deg) as text."""
    both_known = np.all(np.isfinite([error, goal]))
    return " ".join(format_two_digits(x) for x in np.divide(error, goal)) if both_known else "–"


def format_share_percent(share: float | float64) -> str:
    """Return a share in percent as text."""
    return f"{100 * share:.3g} %"


def check_error_goal(
    case_label: str, error: tuple[float, float], goal: tuple[float, float], goal_note: str = ""
) -> list[str]:
    """Return a sentence for each of mm and deg that exceeds the goal.

    error, goal: (mm, deg); goal_note: text after the goal that explains it.
    """
    out = []
    for value, most, unit in zip(error, goal, ERROR_UNITS, strict=True):
        if not value <= most:
            out.append(
                f"{case_label}: {format_two_digits(value)}{unit} is "
                f"{format_two_digits(value / most)} × the goal, "
                f"{format_two_digits(most)}{unit}{goal_note}"
            )
    return out
