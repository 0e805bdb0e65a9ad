"""A cylinder along x of its frame, centred."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from calib.geometry.numpy_or_casadi import ArrayOrExpression
from calib.geometry.se3 import invert_pose, se3_exp, transform_points
from calib.targets.color import Color
from calib.targets.point_template import PointTemplate

CYLINDER_GRAZING_COSINE = 0.02  # smallest cosine of incidence of a beam, also of one that misses
INLIER_SIGMAS = 3  # distance of a return on the cylinder from its surface
LOSS_SCALES = (10.0, 3.0)  # σ at which the robust fit begins to down-weight, coarse then fine
CENTROID_RADII = 0.6  # the centroid of the visible half lies so many radii before the axis


@dataclass(frozen=True)
class Cylinder:
    """A cylinder; see TargetShape for its members. length, radius: m, of the lateral surface."""

    length: float
    radius: float
    color: Color | None = None
    point_template: PointTemplate | None = None

    name = "cylinder"
    pattern = None
    symmetry_axes = (0,)

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> "Cylinder":
        """Make the cylinder of a target's config."""
        color = Color.from_config(config["color"]) if config.get("color") else None
        return cls(config["length_m"], config["radius_m"], color)

    @property
    def uses_exact_surface(self) -> bool:
        """Whether measurements are compared with the exact surface, not with template points."""
        return self.point_template is None

    @property
    def centre(self) -> np.ndarray:
        return np.zeros(3)

    @property
    def bounding_radius(self) -> float:
        return np.hypot(self.length / 2, self.radius)

    @property
    def extents(self) -> np.ndarray:
        return np.array([self.length, 2 * self.radius])

    @property
    def area(self) -> float:
        return self.length * 2 * self.radius

    def outline_points(self) -> np.ndarray:
        ends = (-self.length / 2, self.length / 2)
        return np.concatenate([_circle_points(x, self.radius, self.radius / 2) for x in ends])

    def surface_distance(
        self, x: ArrayOrExpression, y: ArrayOrExpression, z: ArrayOrExpression
    ) -> ArrayOrExpression:
        # The small number keeps the derivative finite on the axis.
        return np.sqrt(y * y + z * z + 1e-20) - self.radius

    def distance_along_beam(
        self, points: ArrayOrExpression, beam: ArrayOrExpression
    ) -> tuple[ArrayOrExpression, ArrayOrExpression]:
        # `root` depends on the beam alone, not on where along it the return lies: range noise then
        # bends neither distance nor cosine. It passes smoothly to the grazing cosine for beams that
        # miss.
        across = beam[1] * beam[1] + beam[2] * beam[2]
        inwards = -(points[1] * beam[1] + points[2] * beam[2])
        beyond = points[1] * points[1] + points[2] * points[2] - self.radius**2
        least = (CYLINDER_GRAZING_COSINE * self.radius) ** 2 * across
        within = inwards * inwards - across * beyond - least
        root = np.sqrt(least + (within + np.sqrt(within * within + least * least)) / 2)
        approach = np.sqrt(inwards * inwards + least)
        return beyond / (approach + root), root / self.radius

    def cap_distance_along_beam(
        self, points: ArrayOrExpression, beam: ArrayOrExpression, end: ArrayOrExpression
    ) -> tuple[ArrayOrExpression, ArrayOrExpression]:
        """Return as distance_along_beam, to the flat end at +x (end 1) or -x (end -1)."""
        # Smoothly held away from zero, for beams along the end.
        steep = beam[0] / (beam[0] * beam[0] + CYLINDER_GRAZING_COSINE**4)
        return (end * self.length / 2 - points[0]) * steep, -end * beam[0]

    def distance_inside_rim(self, points: np.ndarray) -> np.ndarray:
        return self.length / 2 - np.abs(points[:, 0])

    def is_near_cap(self, points: np.ndarray, reach: float) -> np.ndarray:
        off = np.abs(np.abs(points[:, 0]) - self.length / 2)
        return (off < reach) & (np.hypot(points[:, 1], points[:, 2]) < self.radius)

    def check_facing(self, sensor_position: np.ndarray) -> tuple[bool, float]:
        distance = np.linalg.norm(sensor_position)
        from_axis = np.hypot(sensor_position[1], sensor_position[2])
        return bool(distance > self.bounding_radius), float(from_axis / distance)

    def required_image_points(self) -> np.ndarray:
        return np.zeros((0, 3)) if self.color is None else self.outline_points()

    def sample_surface(self, spacing: float) -> np.ndarray:
        """Sample rings on the side and on both caps."""
        half = self.length / 2
        x = np.linspace(-half, half, int(np.ceil(self.length / spacing)) + 1)
        side = np.concatenate([_circle_points(at, self.radius, spacing) for at in x])
        inner = np.arange(0, self.radius, spacing)
        caps = [_circle_points(at, r, spacing) for at in (-half, half) for r in inner]
        return np.concatenate([side, *caps])

    def outline_edges(self) -> np.ndarray:
        return np.zeros((0, 2, 3))

    def fit_inliers(
        self,
        points: np.ndarray,
        T_sensor_target: np.ndarray,
        margin: np.ndarray,
        *,
        range_sigma: float,
        seed: int,
    ) -> np.ndarray:
        """Return the indices of the points on a cylinder of the known radius.

        Its axis is fitted robustly, from the expected attitude at the points. The rotation about
        the axis and the position along it cannot be seen and stay as expected. `seed` is not used.
        """
        T = T_sensor_target.copy()
        beam = points.mean(0) / np.linalg.norm(points.mean(0))
        T[:3, 3] = points.mean(0) + CENTROID_RADII * self.radius * beam
        observable = [1, 2, 4, 5]  # of a twist: shifts along y and z, rotations about y and z
        q = transform_points(invert_pose(T), points)

        def standardized_distance(x: np.ndarray) -> np.ndarray:
            xi = np.zeros(6)
            xi[observable] = x
            moved = transform_points(invert_pose(se3_exp(xi)), q)
            return self.surface_distance(*moved.T) / range_sigma

        x = np.zeros(4)
        for scale in LOSS_SCALES:
            x = least_squares(standardized_distance, x, loss="cauchy", f_scale=scale).x
        if np.linalg.norm(x[2:]) > np.linalg.norm(margin[3:]):
            return np.zeros(0, int)
        return np.flatnonzero(np.abs(standardized_distance(x)) < INLIER_SIGMAS)


def _circle_points(x: float, radius: float, spacing: float) -> np.ndarray:
    """Return points (n, 3) on a circle about the x axis, spacing m apart or a little less."""
    n = max(1, int(np.ceil(2 * np.pi * radius / spacing)))
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.full(n, x), radius * np.cos(angle), radius * np.sin(angle)])
