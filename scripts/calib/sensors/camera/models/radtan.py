"""Pinhole with radial-tangential distortion, as OpenCV's k1 k2 p1 p2 k3; zeros: a plain pinhole."""

import numpy as np

from calib.geometry.numpy_or_casadi import ArrayOrExpression, elementwise_if_else
from calib.sensors.camera.models.polynomial_roots import first_positive_root

PARAMETER_NAMES: tuple[str, ...] = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
OPTIONAL_PARAMETERS: tuple[str, ...] = ("k3",)
N_NEWTON_STEPS = 30


def _distort(
    k: ArrayOrExpression, x: ArrayOrExpression, y: ArrayOrExpression
) -> tuple[ArrayOrExpression, ArrayOrExpression]:
    """Return the distorted normalised coordinates of x, y."""
    _, _, _, _, k1, k2, p1, p2, k3 = k
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def _distortion_jacobian(
    k: tuple[float, ...], x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the entries xx, xy = yx and yy of the derivative of _distort."""
    _, _, _, _, k1, k2, p1, p2, k3 = k
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
    xx = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    yy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    return xx, slope * x * y + 2 * p1 * x + 2 * p2 * y, yy


def project(
    k: ArrayOrExpression, x: ArrayOrExpression, y: ArrayOrExpression, z: ArrayOrExpression
) -> tuple[ArrayOrExpression, ArrayOrExpression]:
    """Return the pixels of points; behind the camera they are finite and without meaning."""
    depth = elementwise_if_else(z > 1e-9, z, 1.0)
    a, b = _distort(k, x / depth, y / depth)
    return k[0] * a + k[2], k[1] * b + k[3]


def is_in_domain(k: tuple[float, ...], x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return whether points lie before the camera and within the radius of the valid distortion.

    Beyond that radius the radial distortion turns back; the tangential one does so a little earlier
    on one side.
    """
    k1, k2, k3 = k[4], k[5], k[8]
    limit = first_positive_root([7 * k3, 5 * k2, 3 * k1, 1])
    is_in_front = z > 1e-9
    depth = np.where(is_in_front, z, 1.0)
    xx, xy, yy = _distortion_jacobian(k, x / depth, y / depth)
    return is_in_front & (x * x + y * y < limit * z * z) & (xx * yy > xy * xy)


def unproject(
    k: tuple[float, ...], u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return rays by Newton's method on the distortion; valid where they project to the pixel."""
    goal_x, goal_y = (u - k[2]) / k[0], (v - k[3]) / k[1]
    x, y = goal_x.copy(), goal_y.copy()
    with np.errstate(all="ignore"):
        for _ in range(N_NEWTON_STEPS):
            a, b = _distort(k, x, y)
            xx, xy, yy = _distortion_jacobian(k, x, y)
            determinant = xx * yy - xy * xy
            ex, ey = goal_x - a, goal_y - b
            x = x + (yy * ex - xy * ey) / determinant
            y = y + (xx * ey - xy * ex) / determinant
        a, b = _distort(k, x, y)
        is_valid = np.hypot(a - goal_x, b - goal_y) < 1e-10 * (1 + np.hypot(goal_x, goal_y))
        is_valid &= is_in_domain(k, x, y, np.ones_like(x))
    x, y = np.where(is_valid, x, 0.0), np.where(is_valid, y, 0.0)
    norm = np.sqrt(x * x + y * y + 1)
    return x / norm, y / norm, 1 / norm, is_valid
