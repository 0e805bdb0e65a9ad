"""Double sphere of Usenko, Demmel and Cremers (2018), equations 40 to 49."""

import numpy as np

from calib.geometry.numpy_or_casadi import ArrayOrExpression, elementwise_if_else

PARAMETER_NAMES: tuple[str, ...] = ("fx", "fy", "cx", "cy", "xi", "alpha")
OPTIONAL_PARAMETERS: tuple[str, ...] = ()


def project(
    k: ArrayOrExpression, x: ArrayOrExpression, y: ArrayOrExpression, z: ArrayOrExpression
) -> tuple[ArrayOrExpression, ArrayOrExpression]:
    """Return the pixels of points (equation 40); outside the domain they have no meaning."""
    xi, alpha = k[4], k[5]
    r2 = x * x + y * y
    d1 = np.sqrt(r2 + z * z + 1e-300)
    shifted = xi * d1 + z
    d2 = np.sqrt(r2 + shifted * shifted + 1e-300)
    raw = alpha * d2 + (1 - alpha) * shifted
    denominator = elementwise_if_else(raw > 1e-12, raw, 1.0)
    return k[0] * x / denominator + k[2], k[1] * y / denominator + k[3]


def is_in_domain(k: tuple[float, ...], x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return whether points lie in the model's domain (equations 43 to 45)."""
    xi, alpha = k[4], k[5]
    w1 = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
    w2 = (w1 + xi) / np.sqrt(2 * w1 * xi + xi * xi + 1)
    d1 = np.sqrt(x * x + y * y + z * z)
    return (z > -w2 * d1) & (d1 > 1e-9)


def unproject(
    k: tuple[float, ...], u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return rays (equations 46 to 49); not valid beyond the image of the domain."""
    xi, alpha = k[4], k[5]
    mx, my = (u - k[2]) / k[0], (v - k[3]) / k[1]
    r2 = mx * mx + my * my
    radicand = 1 - (2 * alpha - 1) * r2
    is_valid = radicand >= 0
    root = np.sqrt(np.where(is_valid, radicand, 0.0))
    mz = (1 - alpha * alpha * r2) / (alpha * root + 1 - alpha)
    radicand = mz * mz + (1 - xi * xi) * r2
    is_valid &= radicand >= 0
    scale = (mz * xi + np.sqrt(np.where(is_valid, radicand, 0.0))) / (mz * mz + r2)
    return scale * mx, scale * my, scale * mz - xi, is_valid
