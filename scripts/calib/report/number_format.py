"""Numbers as the report prints them."""

import numpy as np

MINUS, THIN_SPACE, DASH = "−", "\u202f", "–"


def format_number(x: float | None, digits: int = 3) -> str:
    """Format x with significant digits, far from 1 with an exponent; a dash if x is missing."""
    if x is None or not np.isfinite(x):
        return DASH
    if x != 0 and not 1e-4 <= abs(x) < 1e9:
        mantissa, exponent = f"{x:.{digits - 1}e}".split("e")
        return f"{mantissa}e{int(exponent)}".replace("-", MINUS)
    text = np.format_float_positional(x, precision=digits, fractional=False, trim="-")
    return text.replace("-", MINUS)


def format_decimals(x: float | None, decimals: int) -> str:
    """Format x with decimals; a dash if x is missing."""
    if x is None or not np.isfinite(x):
        return DASH
    # Adding zero turns a rounded -0 into 0.
    return f"{round(x, decimals) + 0.0:.{decimals}f}".replace("-", MINUS)


def choose_decimals(sigma: float | None, max_decimals: int = 6) -> int:
    """Return the decimals that show two significant digits of a σ."""
    if sigma is None or not np.isfinite(sigma) or sigma <= 0:
        return 2
    return int(np.clip(1 - np.floor(np.log10(sigma)), 0, max_decimals))


def format_count(n: int | None) -> str:
    """Format a whole number in groups of three digits."""
    return DASH if n is None else f"{n:,}".replace(",", THIN_SPACE)


def format_percent(share: float) -> str:
    """Format a share of 1 in percent."""
    return f"{format_number(100 * share, 2 if share < 0.1 else 3)} %"


def format_plural(n: int, noun: str) -> str:
    """Format a count with its noun: `1 view`, `2 views`."""
    return f"{format_count(n)} {noun}" + ("" if n == 1 else "s")


def format_kind(kind: str) -> str:
    """Format a kind of measurement: `pattern corner`."""
    return kind.replace("_", " ")


def floor_to_nice_number(x: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is at most x > 0."""
    power = 10.0 ** np.floor(np.log10(x))
    return float(max(f for f in (1, 2, 5) if f * power <= x * (1 + 1e-9)) * power)
