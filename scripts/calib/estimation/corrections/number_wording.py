"""Numbers with their σ as a hypothesis tells them."""

import numpy as np

from calib.geometry.units import DEG_PER_RAD, MM_PER_M

MIN_SHOWN_SIGMAS = 3.0  # σ: a part of several numbers that is smaller is not worth a word


def format_value_sigma(value, sigma, display_factor, unit):
    """`2.00 ± 0.05 %` of a size, in a unit."""
    value, sigma = abs(value) * display_factor, sigma * display_factor
    digits = _decimals_for_sigma(sigma)
    return f"{value:.{digits}f} ± {sigma:.{digits}f}{'' if unit == '°' else ' '}{unit}"


def format_vector_sigma(values, sigmas, factor, unit):
    """`(9.8, 0.1, ?) ± (0.2, 0.2, ?) mm`; what nothing tells has no σ."""
    digits = _decimals_for_sigma(min(s for s in sigmas if s > 0) * factor)
    shown = [
        ", ".join(
            f"{v * factor:.{digits}f}" if s > 0 else "?" for v, s in zip(part, sigmas, strict=True)
        )
        for part in (values, sigmas)
    ]
    return f"({shown[0]}) ± ({shown[1]}){'' if unit == '°' else ' '}{unit}"


def format_twist_sigma(theta, sigma):
    """`(9.8, 0.1, 0.3) ± (0.2, 0.2, 0.2) mm and (…)°` of a twist (6,), m and rad; without a part
    that nothing tells, or that is nothing beside the other."""
    parts = [(theta[:3], sigma[:3], MM_PER_M, "mm"), (theta[3:], sigma[3:], DEG_PER_RAD, "°")]
    parts = [part for part in parts if part[1].any()]
    clear = [part for part in parts if (np.abs(part[0]) > MIN_SHOWN_SIGMAS * part[1]).any()]
    return " and ".join(format_vector_sigma(*part) for part in clear or parts)


def _decimals_for_sigma(sigma):
    """Decimals that show a σ in about two digits."""
    return int(np.clip(1 - np.floor(np.log10(max(sigma, 1e-9))), 0, 6))


def choose_by_sign(value, above, below):
    return above if value > 0 else below
