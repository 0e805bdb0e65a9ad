"""Any shape, given as the points of its template; compared by nearest points only."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from calib.geometry import icp, se3


@dataclass(frozen=True)
class Cloud:
    """points: the template that stands for the shape (targets.points.Points), set on loading."""

    points: object = None

    name = "shape"
    pattern = None
    color = None
    turns = ()

    @classmethod
    def from_config(cls, config):
        return cls()

    @property
    def centre(self):
        template = self.points.template
        return (template.min(0) + template.max(0)) / 2

    @property
    def reach(self):
        return np.linalg.norm(self.points.template - self.centre, axis=1).max()

    @property
    def size(self):
        """Extents along its main axes."""
        centred = self.points.template - self.points.template.mean(0)
        axes = np.linalg.svd(centred, full_matrices=False)[2]
        return np.sort(np.ptp(centred @ axes.T, axis=0))[::-1]

    @property
    def area(self):
        return self.size[0] * self.size[1]

    def outline_points(self):
        template = self.points.template
        return template[ConvexHull(template, qhull_options="QJ").vertices]

    def image_points(self):
        return np.zeros((0, 3))

    def template(self, spacing):
        """Its own points: what was recorded is not thinned or filled."""
        return self.points.template

    def faces(self, p):
        return np.linalg.norm(p - self.centre) > self.reach, 1.0

    def edges(self):
        return np.zeros((0, 2, 3))

    def fit(self, points, T_sensor_target, margin, lidar, options):
        """Indices of the points (n, 3) of one cluster near the template that ICP laid on them."""
        T = icp.icp(self.points, points, T_sensor_target)
        if se3.angle(se3.inverse(T_sensor_target) @ T) > np.linalg.norm(margin[3:]):
            return np.zeros(0, int)
        near = cKDTree(se3.transform(T, self.points.template)).query(points)[0]
        return np.flatnonzero(near < 3 * lidar.range_sigma + self.points.spacing)
