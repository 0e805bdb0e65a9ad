"""Where a distortion polynomial stops being invertible."""

import numpy as np

NO_POSITIVE_ROOT = 1e12  # finite, so that its product with zero is zero


def first_positive_root(coefficients: list[float]) -> float:
    """Return the smallest positive real root of a polynomial, highest power first.

    Returns NO_POSITIVE_ROOT if there is none.
    """
    roots = np.roots(coefficients)
    real = roots[(np.abs(roots.imag) < 1e-12 * (1 + np.abs(roots))) & (roots.real > 0)].real
    return real.min() if len(real) else NO_POSITIVE_ROOT
