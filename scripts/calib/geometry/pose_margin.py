"""Angular reach of an uncertain pose."""

import numpy as np


def angular_margin(margin: np.ndarray, distance: float | np.ndarray) -> float | np.ndarray:
    """Return the angle, rad, by which a point may appear away from its prediction.

    margin: (6,) margin of the pose, m and rad; distance: from the sensor to the point, m.
    """
    return np.linalg.norm(margin[3:]) / np.sqrt(3) * np.sqrt(2) + margin[:3].max() / distance
