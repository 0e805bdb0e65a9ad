"""Corners of a printed pattern in an image; paper equation 3."""

import casadi as ca
import numpy as np

from calib import cameras, geometry
from calib.kinds.assignment import Assignment

UNIT, ROUNDING = "px", 1e-3
DATA = ("u", "v", "x", "y", "z", "weight")


def assign(camera, target, T_sensor_target, keypoints, options, scale):
    """Corners of each view numbered as the labelling that fits the prediction best.

    The offset common to a view is ignored, because a wrong guess shifts the whole pattern first;
    a view whose best two labellings fit nearly alike is left out.
    """
    corners = target.pattern.corners()
    uv, valid = camera.project(geometry.transform(T_sensor_target, corners))
    n = len(keypoints["view"])
    feature = np.full(n, -1)
    for view in np.unique(keypoints["view"]):
        rows = np.flatnonzero(keypoints["view"] == view)
        feature[rows] = _labelling(target.pattern, uv, keypoints, rows)
    value = keypoints["uv"] - uv[feature]
    sigma = scale * keypoints["sigma"]
    far = np.linalg.norm(value, axis=1) > options["gate_sigma"] * sigma
    feature[far | ~valid[feature]] = -1
    ranges = np.linalg.norm(geometry.transform(T_sensor_target, corners[feature]), axis=1)
    cosine = np.full(n, target.faces(geometry.inverse(T_sensor_target)[:3, 3])[1])
    numbers = np.column_stack([keypoints["uv"], corners[feature]])
    return Assignment(feature, np.ones(n, bool), sigma, value, ranges, cosine, numbers)


def _labelling(pattern, predicted, keypoints, rows):
    """Corner of each row of one view, or -1 for all when two labellings fit nearly alike."""
    options = pattern.labellings()[:, keypoints["index"][rows]]
    away = keypoints["uv"][rows] - predicted[options]
    away -= away.mean(1, keepdims=True)
    misfit = np.sqrt((away**2).sum(-1).mean(-1))
    best, second = np.argsort(misfit)[:2]
    return options[best] if misfit[best] < 0.5 * misfit[second] else -1


def residual(camera, target):
    """The measured pixel minus the projected point of the target, over σ; (2)."""
    project = cameras.MODELS[camera.model].project

    def of(R, t, d):
        p = R @ d[2:5] + t
        u, v = project(camera.params, p[0], p[1], p[2])
        return ca.vertcat(d[0] - u, d[1] - v) * d[5]

    return of
