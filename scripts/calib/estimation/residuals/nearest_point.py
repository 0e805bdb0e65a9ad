"""Points against the nearest of a set of target points: the paper's correspondence search, III-D.

TEMPLATE_POINT   returns against the points of the target's template
TEMPLATE_VERTEX  corners of an outline, as ICP fits it to a scan, against the target's own

Residual, equation 2: a measured point p minus the target point q that it is assigned to,
    r = p - Rq - t.
In the first round the centroid of the measured points is laid on that of the target's points,
because a wrong guess shifts the whole target first.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from calib.estimation.residuals.assignment import (
    Assignment,
    Keypoints,
    Noise,
    ResidualExpression,
)
from calib.geometry.numpy_or_casadi import ArrayOrExpression
from calib.geometry.se3 import invert_pose, transform_points
from calib.sensors.lidar.lidar_model import LidarModel


def assign_nearest_points(
    tree: cKDTree,
    T_sensor_target: np.ndarray,
    keypoints: Keypoints,
    *,
    options: Mapping[str, Any],
    noise: Noise,
    shift: np.ndarray | float = 0.0,
    features: np.ndarray | None = None,
) -> Assignment:
    """Assign each measured point to the nearest point of the tree (m, 3), target frame.

    The residual is r turned into the target frame, so that its parts are along and across the
    target. shift (3,): added to the measured points, target frame, for the search alone; features
    (n,): points of the tree to use instead of the nearest, -1 for none.
    """
    p = keypoints["xyz"]
    q = transform_points(invert_pose(T_sensor_target), p)
    near = features
    if features is None:
        distance, near = tree.query(q + shift)
        reach = options["gate_sigma"] * noise.total * keypoints["sigma"]
        features = np.where(distance < reach, near, -1)
    return Assignment(
        candidate_feature=features,
        geometric_weight=np.ones(len(p)),
        repeat_group=np.arange(len(p)),
        keypoint_sigma=keypoints["sigma"],
        residual=q - tree.data[near],
        range=np.linalg.norm(p, axis=1),
        cos_incidence=np.ones(len(p)),
        data=np.column_stack([p, tree.data[near]]),
        noise=noise,
        gate_sigma=options["gate_sigma"],
    )


def centroid_shift(tree: cKDTree, T_sensor_target: np.ndarray, keypoints: Keypoints) -> np.ndarray:
    """Return the shift (3,) from the centroid of the measured points to that of the tree."""
    q = transform_points(invert_pose(T_sensor_target), keypoints["xyz"])
    return tree.data.mean(0) - q.mean(0)


def template_point_residual(
    R: ArrayOrExpression, t: ArrayOrExpression, d: ArrayOrExpression
) -> ArrayOrExpression:
    """Return the expression of r over σ; (3)."""
    return (d[:3] - R @ d[3:6] - t) * d[6]


@dataclass(frozen=True)
class NearestPointKind:
    """A kind of measurement by a lidar whose features are points of the target; a ResidualKind.

    find_tree: returns the tree of a target's points (m, 3), target frame, m.
    """

    find_tree: Callable[[Any], cKDTree]
    UNIT = "m"
    MIN_SIGMA = 1e-6
    DATA_COLUMNS = ("x", "y", "z", "tx", "ty", "tz", "weight")
    USES_TEMPLATE_POINTS = True

    def assign(
        self,
        model: LidarModel,
        target: Any,
        T_sensor_target: np.ndarray,
        keypoints: Keypoints,
        *,
        options: Mapping[str, Any],
        noise: Noise,
        features: np.ndarray | None = None,
    ) -> Assignment:
        """Assign each measured point to the nearest point of the target.

        features: numbers of these points.
        """
        return assign_nearest_points(
            self.find_tree(target),
            T_sensor_target,
            keypoints,
            options=options,
            noise=noise,
            features=features,
        )

    def assign_first(
        self,
        model: LidarModel,
        target: Any,
        T_sensor_target: np.ndarray,
        keypoints: Keypoints,
        *,
        options: Mapping[str, Any],
        noise: Noise,
    ) -> Assignment:
        """Assign as assign does, with the centroids of both laid on each other."""
        tree = self.find_tree(target)
        shift = centroid_shift(tree, T_sensor_target, keypoints)
        return assign_nearest_points(
            tree, T_sensor_target, keypoints, options=options, noise=noise, shift=shift
        )

    def residual(self, model: LidarModel, target: Any) -> ResidualExpression:
        """Return the expression of the measured point minus the target's point over σ; (3)."""
        return template_point_residual


TEMPLATE_POINT = NearestPointKind(lambda target: target.point_template.kd_tree)
TEMPLATE_VERTEX = NearestPointKind(lambda target: cKDTree(target.outline_points()))
