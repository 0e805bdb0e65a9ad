"""The unit normal of two directions, the same lines for NumPy arrays and CasADi expressions."""

import numpy as np

from calib.geometry.numpy_or_casadi import ArrayOrExpression

SQUARED_SINE_AT_ZERO = 1e-20  # keeps the derivative finite where both are parallel


def unit_normal(a: ArrayOrExpression, b: ArrayOrExpression) -> list[ArrayOrExpression]:
    """Return the three components of a × b / |a × b|; a, b: (3, n) arrays or (3) expressions."""
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    length = np.sqrt(x * x + y * y + z * z + SQUARED_SINE_AT_ZERO)
    return [x / length, y / length, z / length]


def dot(
    a: list[ArrayOrExpression] | ArrayOrExpression, b: list[ArrayOrExpression] | ArrayOrExpression
) -> ArrayOrExpression:
    """Return a · b of three components each."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
