"""Numbers and tables as the benchmark's page writes them."""

from typing import NamedTuple

import numpy as np

UNITS = (" mm", "°")


class Section(NamedTuple):
    """A part of the page: its title, its Markdown, and sentences on what it does not reach."""

    title: str
    text: str
    missed: list


def digits(x):
    """x to two significant digits, without an exponent; a dash for nothing."""
    if x is None or not np.isfinite(x):
        return "–"
    return np.format_float_positional(x, precision=2, fractional=False, trim="-")


def both(figure):
    """(mm, deg) as text."""
    if figure is None or not np.all(np.isfinite(figure)):
        return "–"
    return " ".join(digits(x) + unit for x, unit in zip(figure, UNITS, strict=True))


def table(head, rows):
    """A Markdown table of texts."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def ratio(error, goal):
    """error / goal of (mm, deg) as text."""
    both_known = np.all(np.isfinite([error, goal]))
    return " ".join(digits(x) for x in np.divide(error, goal)) if both_known else "–"


def percent(share):
    """A share as text, in percent."""
    return f"{100 * share:.3g} %"


def over(where, got, goal, own=""):
    """Sentences on what of `got` (mm, deg) is above the goal (mm, deg); own: what that goal is."""
    out = []
    for value, most, unit in zip(got, goal, UNITS, strict=True):
        if not value <= most:
            out.append(
                f"{where}: {digits(value)}{unit} is {digits(value / most)} × the goal, "
                f"{digits(most)}{unit}{own}"
            )
    return out
