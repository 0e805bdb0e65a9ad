"""How far a pose that may be wrong reaches, as an angle."""

import numpy as np


def angular_margin(margin, distance):
    """Angle, rad, by which a point at distance, m, may appear beside its prediction."""
    return np.linalg.norm(margin[3:]) / np.sqrt(3) * np.sqrt(2) + margin[:3].max() / distance
