"""Tukey's biweight as robust loss: weight and cost (Beaton and Tukey 1974).

Of a residual of length r, in σ, with the gate c:
    cost    ρ(r) = c²/6 (1 - (1 - (r/c)²)³), constant from the gate on; r²/2 near zero
    weight  w(r) = ρ'(r)/r = (1 - (r/c)²)², zero from the gate on
Weighted least squares with w has the same gradient as the robust cost (Holland and Welsch 1977).
"""

import numpy as np


def tukey_weight(standardized_norm: np.ndarray, gate_sigma: float) -> np.ndarray:
    """Return the weight w (n,) of residuals of that length (n,), σ."""
    return _inside_gate(standardized_norm, gate_sigma) ** 2


def tukey_cost(
    standardized_norm: np.ndarray, effective_weight: np.ndarray, gate_sigma: float
) -> float:
    """Return Σ effective_weight ρ of residuals of that length (n,), σ."""
    inside = _inside_gate(standardized_norm, gate_sigma)
    return gate_sigma**2 / 6 * float(np.sum(effective_weight * (1 - inside**3)))


def _inside_gate(standardized_norm: np.ndarray, gate_sigma: float) -> np.ndarray:
    return np.maximum(1 - (standardized_norm / gate_sigma) ** 2, 0)
