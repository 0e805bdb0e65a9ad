"""Format values with their σ for the descriptions of corrections."""

import numpy as np

from calib.geometry.units import DEG_PER_RAD, MM_PER_M

MIN_SHOWN_SIGMAS = 3.0  # a part of several values below this many σ is not shown


def format_value_sigma(value: float, sigma: float, display_factor: float, unit: str) -> str:
    """Format the size of a value, times display_factor, as `2.00 ± 0.05 %`."""
    value, sigma = abs(value) * display_factor, sigma * display_factor
    digits = _decimals_for_sigma(sigma)
    return f"{value:.{digits}f} ± {sigma:.{digits}f}{_spaced(unit)}"


def format_signed_sigma(value: float, sigma: float) -> str:
    """Format a value without a unit, with its sign, as `-0.134 ± 0.012`."""
    digits = _decimals_for_sigma(sigma)
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def format_vector_sigma(
    values: np.ndarray, sigmas: np.ndarray, display_factor: float, unit: str
) -> str:
    """Format values (q,) as `(9.8, 0.1, ?) ± (0.2, 0.2, ?) mm`; σ is 0 for undetermined ones."""
    digits = _decimals_for_sigma(min(s for s in sigmas if s > 0) * display_factor)
    shown = [
        ", ".join(
            f"{v * display_factor:.{digits}f}" if s > 0 else "?"
            for v, s in zip(part, sigmas, strict=True)
        )
        for part in (values, sigmas)
    ]
    return f"({shown[0]}) ± ({shown[1]}){_spaced(unit)}"


def format_twist_sigma(values: np.ndarray, sigma: np.ndarray) -> str:
    """Format a twist (6,), m and rad, as `(9.8, 0.1, 0.3) ± (0.2, 0.2, 0.2) mm and (…)°`.

    Leaves out a half that is undetermined, or that is insignificant beside the other.
    """
    halves = [(values[:3], sigma[:3], MM_PER_M, "mm"), (values[3:], sigma[3:], DEG_PER_RAD, "°")]
    halves = [half for half in halves if half[1].any()]
    clear = [half for half in halves if (np.abs(half[0]) > MIN_SHOWN_SIGMAS * half[1]).any()]
    return " and ".join(
        format_vector_sigma(part, spread, display_factor=factor, unit=unit)
        for part, spread, factor, unit in clear or halves
    )


def choose_by_sign(value: float, above: str, below: str) -> str:
    """Return `above` for a positive value, else `below`."""
    return above if value > 0 else below


def _spaced(unit: str) -> str:
    return unit if unit == "°" else f" {unit}"


def _decimals_for_sigma(sigma: float) -> int:
    """Return the decimals that show a σ in about two digits."""
    return int(np.clip(1 - np.floor(np.log10(max(sigma, 1e-9))), 0, 6))
