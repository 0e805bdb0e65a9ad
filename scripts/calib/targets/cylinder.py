"""A cylinder along x of its frame, centred."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calib.geometry.se3 import invert_pose, se3_exp, transform_points
from calib.targets.color import Color

CYLINDER_GRAZING_COSINE = (
    0.02  # least cosine of incidence that a ray is taken to have, also one that misses
)


@dataclass(frozen=True)
class Cylinder:
    """length and radius, m, of the lateral surface; color or None; points or None."""

    length: float
    radius: float
    color: object = None
    point_template: object = None

    name = "cylinder"
    pattern = None
    symmetry_axes = (0,)

    @classmethod
    def from_config(cls, config):
        color = config.get("color")
        color = Color.from_config(color) if color else None
        return cls(config["length_m"], config["radius_m"], color)

    @property
    def uses_exact_surface(self) -> bool:
        """Whether measurements are compared with the exact surface, not with template points."""
        return self.point_template is None

    @property
    def centre(self):
        return np.zeros(3)

    @property
    def bounding_radius(self):
        return np.hypot(self.length / 2, self.radius)

    @property
    def extents(self):
        return np.array([self.length, 2 * self.radius])

    @property
    def area(self):
        return self.length * 2 * self.radius

    def outline_points(self):
        ends = (-self.length / 2, self.length / 2)
        return np.concatenate([_circle_points(x, self.radius, self.radius / 2) for x in ends])

    def surface_distance(self, x, y, z):
        # The small number keeps the derivative finite on the axis.
        return np.sqrt(y * y + z * z + 1e-20) - self.radius

    def distance_along_beam(self, points, beam):
        # `root` depends on the beam alone, not on where along it the return lies: range noise then
        # bends neither gap nor cosine. It passes smoothly to GRAZING for beams that miss.
        across = beam[1] * beam[1] + beam[2] * beam[2]
        inwards = -(points[1] * beam[1] + points[2] * beam[2])
        beyond = points[1] * points[1] + points[2] * points[2] - self.radius**2
        least = (CYLINDER_GRAZING_COSINE * self.radius) ** 2 * across
        within = inwards * inwards - across * beyond - least
        root = np.sqrt(least + (within + np.sqrt(within * within + least * least)) / 2)
        approach = np.sqrt(inwards * inwards + least)
        return beyond / (approach + root), root / self.radius

    def cap_distance_along_beam(self, points, beam, end):
        """As gap, to the flat end at +x (end 1) or -x (-1)."""
        # Smoothly held away from zero, for beams along the end.
        steep = beam[0] / (beam[0] * beam[0] + CYLINDER_GRAZING_COSINE**4)
        return (end * self.length / 2 - points[0]) * steep, -end * beam[0]

    def distance_inside_rim(self, points):
        return self.length / 2 - np.abs(points[:, 0])

    def is_near_cap(self, points, reach):
        off = np.abs(np.abs(points[:, 0]) - self.length / 2)
        return (off < reach) & (np.hypot(points[:, 1], points[:, 2]) < self.radius)

    def check_facing(self, sensor_position):
        distance = np.linalg.norm(sensor_position)
        return distance > self.bounding_radius, np.hypot(
            sensor_position[1], sensor_position[2]
        ) / distance

    def required_image_points(self):
        return np.zeros((0, 3)) if self.color is None else self.outline_points()

    def sample_surface(self, spacing):
        """Rings on the side, and rings on both caps, spacing m apart or a little less."""
        half = self.length / 2
        x = np.linspace(-half, half, int(np.ceil(self.length / spacing)) + 1)
        side = np.concatenate([_circle_points(at, self.radius, spacing) for at in x])
        inner = np.arange(0, self.radius, spacing)
        caps = [_circle_points(at, r, spacing) for at in (-half, half) for r in inner]
        return np.concatenate([side, *caps])

    def outline_edges(self):
        return np.zeros((0, 2, 3))

    def fit_inliers(self, points, T_sensor_target, margin, lidar, options):
        """Indices of the points (n, 3) of one cluster on a cylinder of the known radius.

        Its axis and place are fitted from the expected attitude at the cluster, robustly; what it
        cannot tell, the turn about the axis and the place along it, stays as expected.
        """
        T = T_sensor_target.copy()
        beam = points.mean(0) / np.linalg.norm(points.mean(0))
        # The centroid of the visible half lies about 0.6 radii before the axis.
        T[:3, 3] = points.mean(0) + 0.6 * self.radius * beam
        free = [1, 2, 4, 5]
        q = transform_points(invert_pose(T), points)

        def residual(x):
            xi = np.zeros(6)
            xi[free] = x
            moved = transform_points(invert_pose(se3_exp(xi)), q)
            return self.surface_distance(*moved.T) / lidar.range_sigma

        x = np.zeros(4)
        for knee in (10.0, 3.0):
            x = least_squares(residual, x, loss="cauchy", f_scale=knee).x
        if np.linalg.norm(x[2:]) > np.linalg.norm(margin[3:]):
            return np.zeros(0, int)
        return np.flatnonzero(np.abs(residual(x)) < 3)


def _circle_points(x, radius, spacing):
    """Points (n, 3) on a circle about the x axis, spacing m apart or a little less."""
    n = max(1, int(np.ceil(2 * np.pi * radius / spacing)))
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.full(n, x), radius * np.cos(angle), radius * np.sin(angle)])
