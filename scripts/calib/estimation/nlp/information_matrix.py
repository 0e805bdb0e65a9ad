"""Covariances from information matrices whose unknowns differ by orders of magnitude."""

import numpy as np

MIN_INFORMATION = 1e-200  # of an unknown without any; its inverse must not overflow
MIN_EIGENVALUE_RATIO = 1e-13  # to the largest eigenvalue: smaller ones are rounding errors


def scale_to_unit_diagonal(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return factors (n,) that scale the unknowns to unit information, and the scaled matrix."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), MIN_INFORMATION))
    return scale, scale[:, None] * information * scale


def decompose_information(information: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return eigenvalues (n,), eigenvectors (n, n) in units of the unknowns; which are rounding.

    After scaling every unknown to unit information: measurements of a micrometre beside priors of
    a tenth of a millimetre exceed double precision otherwise.
    """
    scale, scaled = scale_to_unit_diagonal(information)
    values, vectors = np.linalg.eigh(scaled)
    return values, scale[:, None] * vectors, values <= MIN_EIGENVALUE_RATIO * values[-1]


def covariance_from_information(information: np.ndarray) -> np.ndarray:
    """Return the covariance (n, n), positive semidefinite by construction.

    Undetermined directions get zero variance; diagnosis/observability.py names them.
    """
    values, vectors, is_rounding = decompose_information(information)
    root = vectors[:, ~is_rounding] / np.sqrt(values[~is_rounding])
    return root @ root.T


def invert_information(information: np.ndarray) -> np.ndarray:
    """Return the inverse (n, n), faster than the covariance; undetermined directions are huge."""
    scale, scaled = scale_to_unit_diagonal(information)
    scaled += MIN_EIGENVALUE_RATIO * np.eye(len(scale))
    return scale[:, None] * np.linalg.inv(scaled) * scale
