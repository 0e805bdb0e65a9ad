"""Corners of a printed pattern in an image; paper equation 3."""

import casadi as ca
import numpy as np

from calib.estimation.residuals.assignment import Assignment
from calib.geometry.se3 import invert_pose, transform_points
from calib.sensors.camera.camera_model import CAMERA_MODELS

UNIT, MIN_SIGMA = "px", 1e-3
DATA_COLUMNS = ("u", "v", "x", "y", "z", "a", "b", "c", "weight")


def assign(camera, target, T_sensor_target, keypoints, options, noise, features=None):
    """Corners of each view numbered as the labelling that fits the prediction best.

    The offset common to a view is ignored, because a wrong guess shifts the whole pattern first;
    a view whose best two labellings fit nearly alike is left out. features (n,): corner of each
    measurement where it was assigned before, -1 for none.
    """
    corners = target.pattern.corners()
    uv, valid = camera.project(transform_points(T_sensor_target, corners))
    n = len(keypoints["view"])
    corner = _choose_corners(target.pattern, uv, keypoints) if features is None else features
    at, whiten = corners[corner], keypoints["whitening"]
    cosine = target.check_facing(invert_pose(T_sensor_target)[:3, 3])[1]
    return Assignment(
        candidate_feature=np.where(valid[corner], corner, -1),
        geometric_weight=np.ones(n),
        repeat_group=np.maximum(corner, 0),
        keypoint_sigma=keypoints["sigma"],
        residual=keypoints["uv"] - uv[corner],
        range=np.linalg.norm(transform_points(T_sensor_target, at), axis=1),
        cos_incidence=np.full(n, cosine),
        data=np.column_stack([keypoints["uv"], at, whiten]),
        noise=noise,
        gate_sigma=options["gate_sigma"],
        whitening=whiten,
    )


def _choose_corners(pattern, predicted, keypoints):
    """Corner (n,) of each measurement, or -1 in a view whose best two labellings fit alike."""
    corner = np.full(len(keypoints["view"]), -1)
    for view in np.unique(keypoints["view"]):
        rows = np.flatnonzero(keypoints["view"] == view)
        corner[rows] = _choose_labelling(pattern, predicted, keypoints, rows)
    return corner


def _choose_labelling(pattern, predicted, keypoints, rows):
    """Corner of each row of one view, or -1 for all when two labellings fit nearly alike."""
    options, misfit = score_labellings(pattern, predicted, keypoints, rows)
    if len(options) == 1:
        return options[0]
    best, second = np.argsort(misfit)[:2]
    return options[best] if misfit[best] < 0.5 * misfit[second] else -1


def score_labellings(pattern, predicted, keypoints, rows):
    """Corners (m, k) of the rows (k,) of one view by each labelling, and how far (m,), px, rms, the
    measured ones then lie from predicted pixels, but for an offset that they share."""
    options = pattern.corner_orders()[:, keypoints["feature_index"][rows]]
    away = keypoints["uv"][rows] - predicted[options]
    away -= away.mean(1, keepdims=True)
    return options, np.sqrt((away**2).sum(-1).mean(-1))


def residual(camera, target):
    """The measured pixel minus the projected point of the target, whitened, over σ; (2)."""
    project = CAMERA_MODELS[camera.model].project

    def of(R, t, d):
        p = R @ d[2:5] + t
        u, v = project(camera.params, p[0], p[1], p[2])
        du, dv = d[0] - u, d[1] - v
        return ca.vertcat(d[5] * du + d[6] * dv, d[7] * dv) * d[8]

    return of
