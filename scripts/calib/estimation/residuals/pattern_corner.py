"""Corners of a printed pattern in an image; paper equation 3.

Residual: the measured pixel minus the projection π of the corner q of the target, whitened,
    r = W ((u, v) - π(Rq + t)),   W = [[a, b], [0, c]].
π is project of the camera's model, the same lines for arrays and expressions.
"""

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from calib.estimation.residuals.assignment import (
    Assignment,
    Keypoints,
    Noise,
    ResidualExpression,
)
from calib.geometry.numpy_or_casadi import ArrayOrExpression
from calib.geometry.se3 import invert_pose, transform_points
from calib.sensors.camera.camera_model import CAMERA_MODELS, CameraModel
from calib.targets.board import Board

UNIT, MIN_SIGMA = "px", 1e-3
DATA_COLUMNS = ("u", "v", "x", "y", "z", "a", "b", "c", "weight")
USES_TEMPLATE_POINTS = False
MAX_LABELLING_RATIO = 0.5  # of the misfits of the best and the second best labelling of a view


def assign(
    model: CameraModel,
    target: Board,
    T_sensor_target: np.ndarray,
    keypoints: Keypoints,
    *,
    options: Mapping[str, Any],
    noise: Noise,
    features: np.ndarray | None = None,
) -> Assignment:
    """Assign the corners of each view by the labelling that fits the prediction best.

    The mean offset of a view is ignored, because a wrong guess shifts the whole pattern first. A
    view whose best two labellings fit nearly alike is left out. features: corners of the pattern.
    """
    pattern: Any = target.pattern
    corners = target.lift(pattern.corners())
    uv, valid = model.project(transform_points(T_sensor_target, corners))
    n = len(keypoints["view"])
    corner = _choose_corners(pattern, uv, keypoints) if features is None else features
    q, whitening = corners[corner], keypoints["whitening"]
    cosine = target.check_facing(invert_pose(T_sensor_target)[:3, 3])[1]
    return Assignment(
        candidate_feature=np.where(valid[corner], corner, -1),
        geometric_weight=np.ones(n),
        repeat_group=np.maximum(corner, 0),
        keypoint_sigma=keypoints["sigma"],
        residual=keypoints["uv"] - uv[corner],
        range=np.linalg.norm(transform_points(T_sensor_target, q), axis=1),
        cos_incidence=np.full(n, cosine),
        data=np.column_stack([keypoints["uv"], q, whitening]),
        noise=noise,
        gate_sigma=options["gate_sigma"],
        whitening=whitening,
    )


assign_first = assign


def residual(model: CameraModel, target: Any) -> ResidualExpression:
    """Return the expression of the whitened difference over σ; (2)."""
    project = CAMERA_MODELS[model.model].project

    def weighted_difference(
        R: ArrayOrExpression, t: ArrayOrExpression, d: ArrayOrExpression
    ) -> ArrayOrExpression:
        p = R @ d[2:5] + t
        u, v = project(model.params, p[0], p[1], p[2])
        du, dv = d[0] - u, d[1] - v
        return ca.vertcat(d[5] * du + d[6] * dv, d[7] * dv) * d[8]

    return weighted_difference


def score_labellings(
    pattern: Any, predicted: np.ndarray, keypoints: Keypoints, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Score every labelling of the rows (k,) of one view against predicted pixels (c, 2).

    Returns the corners (m, k) by each labelling, and the rms (m,), px, of the distances to the
    predicted pixels without their mean offset.
    """
    labellings = pattern.corner_orders()[:, keypoints["feature_index"][rows]]
    offset = keypoints["uv"][rows] - predicted[labellings]
    offset -= offset.mean(1, keepdims=True)
    return labellings, np.sqrt((offset**2).sum(-1).mean(-1))


def _choose_corners(pattern: Any, predicted: np.ndarray, keypoints: Keypoints) -> np.ndarray:
    """Return the corner (n,) of each measurement, -1 in views with two labellings alike."""
    corner = np.full(len(keypoints["view"]), -1)
    for view in np.unique(keypoints["view"]):
        rows = np.flatnonzero(keypoints["view"] == view)
        corner[rows] = _choose_labelling(pattern, predicted, keypoints, rows)
    return corner


def _choose_labelling(
    pattern: Any, predicted: np.ndarray, keypoints: Keypoints, rows: np.ndarray
) -> np.ndarray | int:
    """Return the corner (k,) of each row of one view, or -1 if two labellings fit nearly alike."""
    labellings, misfit = score_labellings(pattern, predicted, keypoints, rows)
    if len(labellings) == 1:
        return labellings[0]
    best, second = np.argsort(misfit)[:2]
    return labellings[best] if misfit[best] < MAX_LABELLING_RATIO * misfit[second] else -1
