"""Rotations from directions."""

import numpy as np

from calib import geometry


def between(a, b):
    """The rotation (3, 3) that turns a (3,) to the direction of b (3,), the short way."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis, cosine = np.cross(a, b), a @ b
    sine = np.linalg.norm(axis)
    if sine < 1e-9:
        aside = np.linalg.svd(a[None])[2][1]
        return np.eye(3) if cosine > 0 else geometry.so3_exp(np.pi * aside)
    return geometry.so3_exp(axis / sine * np.arctan2(sine, cosine))
