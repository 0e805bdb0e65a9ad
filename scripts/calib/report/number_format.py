"""Numbers as the report prints them."""

import numpy as np

MINUS, THIN_SPACE, DASH = "−", "\u202f", "–"


def format_number(x, digits=3):
    """x with so many significant digits, an exponent only far from 1; a dash for nothing."""
    if x is None or not np.isfinite(x):
        return DASH
    if x != 0 and not 1e-4 <= abs(x) < 1e9:
        mantissa, exponent = f"{x:.{digits - 1}e}".split("e")
        return f"{mantissa}e{int(exponent)}".replace("-", MINUS)
    text = np.format_float_positional(x, precision=digits, fractional=False, trim="-")
    return text.replace("-", MINUS)


def format_decimals(x, decimals):
    """x with so many decimals; a dash for nothing."""
    if x is None or not np.isfinite(x):
        return DASH
    # Adding zero turns a rounded -0 into 0.
    return f"{round(x, decimals) + 0.0:.{decimals}f}".replace("-", MINUS)


def choose_decimals(sigma, max_decimals=6):
    """Decimals that show two significant digits of a σ."""
    if sigma is None or not np.isfinite(sigma) or sigma <= 0:
        return 2
    return int(np.clip(1 - np.floor(np.log10(sigma)), 0, max_decimals))


def format_count(n):
    """A whole number in groups of three digits."""
    return DASH if n is None else f"{n:,}".replace(",", THIN_SPACE)


def format_percent(share):
    """A share in percent."""
    return f"{format_number(100 * share, 2 if share < 0.1 else 3)} %"


def format_plural(n, word):
    """`1 view`, `2 views`."""
    return f"{format_count(n)} {word}" + ("" if n == 1 else "s")


def floor_to_nice_number(x):
    """The largest of 1, 2, 5 times a power of ten that is at most x > 0."""
    power = 10.0 ** np.floor(np.log10(x))
    return float(max(f for f in (1, 2, 5) if f * power <= x * (1 + 1e-9)) * power)
