"""The side of a cylinder in an image: rays that touch it, exact for every camera model.

Residual: the distance of the ray d of a contour point from the axis x through t, on the side s =
±1 of the axis where it was found, less the radius, in pixels,
    r = (s n · t - radius) px_per_m,   n = x × d / |x × d|.
It replaces the paper's nearest template point (section III-D).
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
    number_repeat_groups,
    taper_weight,
)
from calib.geometry.numpy_or_casadi import ArrayOrExpression
from calib.sensors.camera.camera_model import CameraModel
from calib.targets.cylinder import Cylinder

UNIT, MIN_SIGMA = "px", 1e-2
DATA_COLUMNS = ("dx", "dy", "dz", "side", "px_per_m", "weight")
USES_TEMPLATE_POINTS = False
END_TAPER_M = 0.02  # along the axis, over which the weight of a contour point rises from an end
N_LIMB_PIECES = 8  # of a limb; every image repeats the error of a piece
RAY_STEP_RAD = 1e-4  # between the rays that give the scale of the image


def assign(
    model: CameraModel,
    target: Cylinder,
    T_sensor_target: np.ndarray,
    keypoints: Keypoints,
    *,
    options: Mapping[str, Any],
    noise: Noise,
    features: np.ndarray | None = None,
) -> Assignment:
    """Assign contour points to the side of the cylinder, away from its ends.

    features: 0, or -1 for none.
    """
    ray, valid = model.unproject(keypoints["uv"])
    axis, centre = T_sensor_target[:3, 0], T_sensor_target[:3, 3]
    normal = np.cross(axis, ray)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    side = keypoints["feature_index"].astype(float)
    # Where the ray and the axis come closest: how far along both lines.
    across = np.cross(normal, axis)
    depth = (across @ centre) / np.sum(across * ray, 1)
    along = ray @ axis * depth - centre @ axis
    px_per_m = _pixels_per_radian(model, ray, normal) / np.maximum(np.abs(depth), 1e-6)
    value = (side * (normal @ centre) - target.radius) * px_per_m
    trust = taper_weight(target.length / 2 - options["edge_margin_m"] - np.abs(along), END_TAPER_M)
    return Assignment(
        candidate_feature=np.zeros(len(side), int) if features is None else features,
        geometric_weight=np.where(valid & (depth > 0), trust, 0.0),
        repeat_group=number_repeat_groups(side, _limb_piece_number(along / target.length)),
        keypoint_sigma=keypoints["sigma"],
        residual=value[:, None],
        range=depth,
        cos_incidence=np.sqrt(np.clip(1 - (normal @ centre) ** 2 / (centre @ centre), 0, 1)),
        data=np.column_stack([ray, side, px_per_m]),
        noise=noise,
        gate_sigma=options["gate_sigma"],
    )


assign_first = assign


def residual(model: CameraModel, target: Cylinder) -> ResidualExpression:
    """Return the expression of the distance from the limb over σ; (1)."""

    def weighted_distance(
        R: ArrayOrExpression, t: ArrayOrExpression, d: ArrayOrExpression
    ) -> ArrayOrExpression:
        normal = ca.cross(R[:, 0], d[:3])
        distance = d[3] * ca.dot(normal, t) / ca.sqrt(ca.dot(normal, normal) + 1e-20)
        return (distance - target.radius) * d[4] * d[5]

    return weighted_distance


def _limb_piece_number(share: np.ndarray) -> np.ndarray:
    """Number the pieces (n,) of the limb, from places along the axis over its length (n,)."""
    return np.floor(N_LIMB_PIECES * np.clip(np.nan_to_num(share), -0.5, 0.5))


def _pixels_per_radian(camera: CameraModel, ray: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the pixels (n,) per radian at rays (n, 3), in the direction of unit normals (n, 3)."""
    beside = [camera.project(ray + side * RAY_STEP_RAD * normal)[0] for side in (-1, 1)]
    return np.linalg.norm(beside[1] - beside[0], axis=1) / (2 * RAY_STEP_RAD)
