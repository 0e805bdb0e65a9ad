"""Equidistant fisheye of Kannala and Brandt (2006), as OpenCV's k1 to k4."""

import numpy as np

from calib.geometry.numpy_or_casadi import ArrayOrExpression, elementwise_if_else
from calib.sensors.camera.models.polynomial_roots import first_positive_root

PARAMETER_NAMES: tuple[str, ...] = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
OPTIONAL_PARAMETERS: tuple[str, ...] = ()
N_NEWTON_STEPS = 30


def _distort_angle(k: ArrayOrExpression, theta: ArrayOrExpression) -> ArrayOrExpression:
    """Return the radius, in focal lengths, of a ray at an angle theta, rad, to the axis."""
    t2 = theta * theta
    return theta * (1 + t2 * (k[4] + t2 * (k[5] + t2 * (k[6] + t2 * k[7]))))


def project(
    k: ArrayOrExpression, x: ArrayOrExpression, y: ArrayOrExpression, z: ArrayOrExpression
) -> tuple[ArrayOrExpression, ArrayOrExpression]:
    """Return the pixels of points in any direction."""
    r2 = x * x + y * y
    # On the axis theta / r tends to 1 / z; the other branch would divide by zero.
    on_axis = r2 < 1e-18 * z * z + 1e-30
    r = np.sqrt(elementwise_if_else(on_axis, 1.0, r2))
    depth = elementwise_if_else(z * z > 1e-30, z, 1.0)
    scale = elementwise_if_else(on_axis, 1 / depth, _distort_angle(k, np.arctan2(r, z)) / r)
    return k[0] * scale * x + k[2], k[1] * scale * y + k[3]


def is_in_domain(k: tuple[float, ...], x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return whether points lie below the angle at which the polynomial turns back, at most π."""
    limit = _max_angle(k)
    r = np.sqrt(x * x + y * y)
    theta = np.arctan2(r, z)
    return (theta < limit) & (r * r + z * z > 1e-18)


def _max_angle(k: tuple[float, ...]) -> float:
    """Return the largest angle, rad, to the axis at which the model is valid."""
    turning_point = first_positive_root([9 * k[7], 7 * k[6], 5 * k[5], 3 * k[4], 1])
    return min(np.sqrt(turning_point), np.pi - 1e-6)


def unproject(
    k: tuple[float, ...], u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return rays by Newton's method on the angle, kept inside the model's domain."""
    a, b = (u - k[2]) / k[0], (v - k[3]) / k[1]
    goal = np.hypot(a, b)
    limit = _max_angle(k)
    theta = np.minimum(goal, limit)
    for _ in range(N_NEWTON_STEPS):
        t2 = theta * theta
        slope = 1 + t2 * (3 * k[4] + t2 * (5 * k[5] + t2 * (7 * k[6] + t2 * 9 * k[7])))
        step = (_distort_angle(k, theta) - goal) / np.where(np.abs(slope) > 1e-9, slope, 1e-9)
        previous, theta = theta, np.clip(theta - step, 0, limit)
        if np.array_equal(theta, previous):
            break
    is_valid = np.abs(_distort_angle(k, theta) - goal) < 1e-10 * (1 + goal)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.where(goal > 1e-15, np.sin(theta) / goal, 1.0)
    return scale * a, scale * b, np.cos(theta), is_valid
