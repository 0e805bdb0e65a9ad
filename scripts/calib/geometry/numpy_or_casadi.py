"""What lets one source serve NumPy arrays and CasADi expressions.

Arithmetic and the ufuncs of NumPy dispatch by themselves; branches do not.
"""

import numpy as np


def elementwise_if_else(condition, a, b):
    """Elementwise a where condition holds, else b; both are evaluated and must be finite."""
    if isinstance(condition, (bool, np.bool_, np.ndarray)):
        return np.where(condition, a, b)
    import casadi

    return casadi.if_else(condition, a, b)
