"""Lidar returns against the nearest point of the target's template; paper equation 2."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.estimation.residuals.assignment import (
    Assignment,
    Keypoints,
    Noise,
    ResidualExpression,
)
from calib.estimation.residuals.nearest_point import (
    assign_nearest_points,
    centroid_shift,
    template_point_residual,
)
from calib.sensors.lidar.lidar_model import LidarModel

UNIT, MIN_SIGMA = "m", 1e-6
DATA_COLUMNS = ("x", "y", "z", "tx", "ty", "tz", "weight")
USES_TEMPLATE_POINTS = True


def assign(
    model: LidarModel,
    target: Any,
    T_sensor_target: np.ndarray,
    keypoints: Keypoints,
    *,
    options: Mapping[str, Any],
    noise: Noise,
    features: np.ndarray | None = None,
) -> Assignment:
    """Assign each return to the nearest point of the template.

    features: numbers of these points.
    """
    return assign_nearest_points(
        target.point_template.kd_tree,
        T_sensor_target,
        keypoints,
        options=options,
        noise=noise,
        features=features,
    )


def assign_first(
    model: LidarModel,
    target: Any,
    T_sensor_target: np.ndarray,
    keypoints: Keypoints,
    *,
    options: Mapping[str, Any],
    noise: Noise,
) -> Assignment:
    """Assign as assign does, with the centroids of both laid on each other."""
    tree = target.point_template.kd_tree
    shift = centroid_shift(tree, T_sensor_target, keypoints)
    return assign_nearest_points(
        tree, T_sensor_target, keypoints, options=options, noise=noise, shift=shift
    )


def residual(model: LidarModel, target: Any) -> ResidualExpression:
    """Return the expression of the return minus its template point over σ; (3)."""
    return template_point_residual
