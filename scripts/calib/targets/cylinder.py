"""A cylinder along x of its frame, centred."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calib import geometry


@dataclass(frozen=True)
class Cylinder:
    """length and radius, m, of the lateral surface."""

    length: float
    radius: float

    name = "cylinder"
    pattern = None

    @classmethod
    def from_config(cls, config):
        return cls(config["length_m"], config["radius_m"])

    @property
    def centre(self):
        return np.zeros(3)

    @property
    def reach(self):
        return np.hypot(self.length / 2, self.radius)

    @property
    def size(self):
        return np.array([self.length, 2 * self.radius])

    @property
    def area(self):
        return self.length * 2 * self.radius

    def outline_points(self):
        angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        ring = self.radius * np.column_stack([np.cos(angle), np.sin(angle)])
        ends = [
            np.column_stack([np.full(12, x), ring]) for x in (-self.length / 2, self.length / 2)
        ]
        return np.concatenate(ends)

    def distance(self, x, y, z):
        # The small number keeps the derivative finite on the axis.
        return np.sqrt(y * y + z * z + 1e-20) - self.radius

    def normal(self, q):
        n = q * [0.0, 1.0, 1.0]
        return n / np.maximum(np.linalg.norm(n, axis=1), 1e-12)[:, None]

    def depth(self, q):
        return self.length / 2 - np.abs(q[:, 0])

    def faces(self, p):
        distance = np.linalg.norm(p)
        return distance > self.reach, np.hypot(p[1], p[2]) / distance

    def edges(self):
        return np.zeros((0, 2, 3))

    def fit(self, points, T_sensor_target, margin, lidar, options):
        """Indices of the points (n, 3) of one cluster on a cylinder of the known radius.

        Its axis and place are fitted from the expected attitude at the cluster, robustly; what it
        cannot tell, the turn about the axis and the place along it, stays as expected.
        """
        T = T_sensor_target.copy()
        beam = points.mean(0) / np.linalg.norm(points.mean(0))
        # The centroid of the visible half lies about 0.6 radii before the axis.
        T[:3, 3] = points.mean(0) + 0.6 * self.radius * beam
        free = [1, 2, 4, 5]
        q = geometry.transform(geometry.inverse(T), points)

        def residual(x):
            xi = np.zeros(6)
            xi[free] = x
            moved = geometry.transform(geometry.inverse(geometry.se3_exp(xi)), q)
            return self.distance(*moved.T) / lidar.range_sigma

        x = np.zeros(4)
        for knee in (10.0, 3.0):
            x = least_squares(residual, x, loss="cauchy", f_scale=knee).x
        if np.linalg.norm(x[2:]) > np.linalg.norm(margin[3:]):
            return np.zeros(0, int)
        return np.flatnonzero(np.abs(residual(x)) < 3)
