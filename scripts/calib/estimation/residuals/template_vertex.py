"""Corners of an outline, as ICP fits it to a scan, against the target's own; paper equation 2."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

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
    """Assign each corner to the nearest corner of the outline.

    features: numbers of these points.
    """
    return assign_nearest_points(
        cKDTree(target.outline_points()),
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
    tree = cKDTree(target.outline_points())
    shift = centroid_shift(tree, T_sensor_target, keypoints)
    return assign_nearest_points(
        tree, T_sensor_target, keypoints, options=options, noise=noise, shift=shift
    )


def residual(model: LidarModel, target: Any) -> ResidualExpression:
    """Return the expression of the corner minus that of the outline over σ; (3)."""
    return template_point_residual
