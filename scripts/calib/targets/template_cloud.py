"""A shape given as the points of its template; compared by nearest points only."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from calib.geometry.icp import register_template_icp
from calib.geometry.se3 import invert_pose, rotation_angle, transform_points
from calib.targets.point_template import PointTemplate, load_point_template

INLIER_SIGMAS = 3  # distance of a return on the target from the template, beside its spacing


@dataclass(frozen=True)
class TemplateCloud:
    """A shape of points; see TargetShape for its members."""

    point_template: PointTemplate

    name = "shape"
    pattern = None
    color = None
    symmetry_axes = ()
    uses_exact_surface = False

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> "TemplateCloud":
        """Make the shape of a target's config from its template file."""
        return cls(load_point_template(config["points"]))

    @property
    def _xyz(self) -> np.ndarray:
        """Points (n, 3) of the template, m, target frame."""
        return self.point_template.xyz

    @property
    def centre(self) -> np.ndarray:
        return (self._xyz.min(0) + self._xyz.max(0)) / 2

    @property
    def bounding_radius(self) -> float:
        return np.linalg.norm(self._xyz - self.centre, axis=1).max()

    @property
    def extents(self) -> np.ndarray:
        """Extents (3,), m, along its main axes."""
        centred = self._xyz - self._xyz.mean(0)
        axes = np.linalg.svd(centred, full_matrices=False)[2]
        return np.sort(np.ptp(centred @ axes.T, axis=0))[::-1]

    @property
    def area(self) -> float:
        return self.extents[0] * self.extents[1]

    def outline_points(self) -> np.ndarray:
        return self._xyz[ConvexHull(self._xyz, qhull_options="QJ").vertices]

    def required_image_points(self) -> np.ndarray:
        return np.zeros((0, 3))

    def sample_surface(self, spacing: float) -> np.ndarray:
        """Return the template's own points: what was recorded is not thinned or filled."""
        return self._xyz

    def check_facing(self, sensor_position: np.ndarray) -> tuple[bool, float]:
        distance = np.linalg.norm(sensor_position - self.centre)
        return bool(distance > self.bounding_radius), 1.0

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
        """Return the indices of the points near the template that ICP laid on them.

        `seed` is not used.
        """
        T = register_template_icp(self.point_template, points, T_sensor_target)
        if rotation_angle(invert_pose(T_sensor_target) @ T) > np.linalg.norm(margin[3:]):
            return np.zeros(0, int)
        distance = cKDTree(transform_points(T, self._xyz)).query(points)[0]
        return np.flatnonzero(distance < INLIER_SIGMAS * range_sigma + self.point_template.spacing)
