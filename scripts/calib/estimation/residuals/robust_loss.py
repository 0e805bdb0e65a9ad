"""Tukey's biweight: the robust loss, its weight and its cost."""

import numpy as np


def taper_weight(beyond, width):
    """0 at and below a limit, 1 from width beyond it on, linear between."""
    return np.clip(beyond / width, 0, 1)


def tukey_weight(size, gate):
    """Weight (n,) of Tukey's biweight for residuals of a size (n,), in σ; 0 from the gate on."""
    return np.maximum(1 - (size / gate) ** 2, 0) ** 2


def tukey_cost(standardized_norm, effective_weight, gate):
    """Tukey's biweight of residuals of a standardized_norm (n,), in σ. It ends at the gate, so that nothing
    jumps when a measurement crosses it; near zero it is half the square (weight: loss_weight)."""
    inside = np.maximum(1 - (standardized_norm / gate) ** 2, 0)
    return gate**2 / 6 * float(np.sum(effective_weight * (1 - inside**3)))
