"""Any shape, given as the points of its template; compared by nearest points only."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from calib.geometry.icp import register_template_icp
from calib.geometry.se3 import invert_pose, rotation_angle, transform_points


@dataclass(frozen=True)
class TemplateCloud:
    """points: the template that stands for the shape (targets.points.Points), set on loading."""

    point_template: object = None

    name = "shape"
    pattern = None
    color = None
    symmetry_axes = ()
    uses_exact_surface = False

    @classmethod
    def from_config(cls, config):
        return cls()

    @property
    def centre(self):
        template = self.point_template.xyz
        return (template.min(0) + template.max(0)) / 2

    @property
    def bounding_radius(self):
        return np.linalg.norm(self.point_template.xyz - self.centre, axis=1).max()

    @property
    def extents(self):
        """Extents along its main axes."""
        centred = self.point_template.xyz - self.point_template.xyz.mean(0)
        axes = np.linalg.svd(centred, full_matrices=False)[2]
        return np.sort(np.ptp(centred @ axes.T, axis=0))[::-1]

    @property
    def area(self):
        return self.extents[0] * self.extents[1]

    def outline_points(self):
        template = self.point_template.xyz
        return template[ConvexHull(template, qhull_options="QJ").vertices]

    def required_image_points(self):
        return np.zeros((0, 3))

    def sample_surface(self, spacing):
        """Its own points: what was recorded is not thinned or filled."""
        return self.point_template.xyz

    def check_facing(self, sensor_position):
        return np.linalg.norm(sensor_position - self.centre) > self.bounding_radius, 1.0

    def outline_edges(self):
        return np.zeros((0, 2, 3))

    def fit_inliers(self, points, T_sensor_target, margin, lidar, options):
        """Indices of the points (n, 3) of one cluster near the template that ICP laid on them."""
        T = register_template_icp(self.point_template, points, T_sensor_target)
        if rotation_angle(invert_pose(T_sensor_target) @ T) > np.linalg.norm(margin[3:]):
            return np.zeros(0, int)
        near = cKDTree(transform_points(T, self.point_template.xyz)).query(points)[0]
        return np.flatnonzero(near < 3 * lidar.range_sigma + self.point_template.spacing)
