"""Functions that accept NumPy arrays and CasADi expressions alike.

Arithmetic and NumPy's ufuncs dispatch by themselves; branches do not.
"""

from typing import Any, TypeAlias

import numpy as np

# An array, a number or a casadi.SX; casadi has no type hints.
ArrayOrExpression: TypeAlias = Any


def elementwise_if_else(
    condition: ArrayOrExpression, a: ArrayOrExpression, b: ArrayOrExpression
) -> ArrayOrExpression:
    """Return elementwise a where condition holds, else b; both are evaluated and must be finite."""
    if isinstance(condition, (bool, np.bool_, np.ndarray)):
        return np.where(condition, a, b)
    import casadi

    return casadi.if_else(condition, a, b)
