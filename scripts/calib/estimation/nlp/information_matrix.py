"""Covariances from information matrices whose unknowns differ by orders of magnitude."""

import numpy as np

MIN_INFORMATION = 1e-200  # of an unknown that nothing tells; its inverse must not overflow
MIN_EIGENVALUE_RATIO = 1e-13  # of the largest eigenvalue: below this an eigenvalue is rounding


def scale_to_unit_diagonal(information):
    """Factors (n,) of the unknowns that give each unit information, and the matrix (n, n) then."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), MIN_INFORMATION))
    return scale, scale[:, None] * information * scale


def decompose_information(information):
    """Eigenvalues (n,), eigenvectors (n, n) in the units of the unknowns, and which are rounding.

    Taken after scaling every unknown to unit information, for measurements of a micrometre beside
    pose priors of a tenth of a millimetre leave no other way through double precision.
    """
    scale, scaled = scale_to_unit_diagonal(information)
    values, vectors = np.linalg.eigh(scaled)
    return values, scale[:, None] * vectors, values <= MIN_EIGENVALUE_RATIO * values[-1]


def covariance_from_information(information):
    """Covariance (n, n) of all unknowns, positive semidefinite by construction.

    Directions that nothing determines are held; observability.undetermined names them.
    """
    values, vectors, rounding = decompose_information(information)
    root = vectors[:, ~rounding] / np.sqrt(values[~rounding])
    return root @ root.T


def invert_information(information):
    """Inverse (n, n), quicker than `covariance`; directions that nothing determines are vast."""
    scale, scaled = scale_to_unit_diagonal(information)
    scaled += MIN_EIGENVALUE_RATIO * np.eye(len(scale))
    return scale[:, None] * np.linalg.inv(scaled) * scale
