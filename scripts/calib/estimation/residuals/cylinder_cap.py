"""Lidar returns on the flat ends of a cylinder, which alone determine its place along its axis.

Residual: the distance along the beam u = p/|p| from a return p to the end e = ±1,
    r = gap(Rᵀ(p - t), Rᵀu, e),
where gap is cap_distance_along_beam of the cylinder, the same lines for arrays and expressions.
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
    taper_weight,
)
from calib.estimation.residuals.target_surface import (
    EDGE_TAPER_M,
    INCIDENCE_TAPER_COS,
    returns_in_target_frame,
)
from calib.geometry.numpy_or_casadi import ArrayOrExpression
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.cylinder import Cylinder

UNIT, MIN_SIGMA = "m", 1e-7
DATA_COLUMNS = ("x", "y", "z", "end", "weight")
USES_TEMPLATE_POINTS = False


def assign(
    model: LidarModel,
    target: Cylinder,
    T_sensor_target: np.ndarray,
    keypoints: Keypoints,
    *,
    options: Mapping[str, Any],
    noise: Noise,
    features: np.ndarray | None = None,
) -> Assignment:
    """Assign returns whose beams meet the end that faces the lidar, within its rim.

    features: 1 for the end towards +x, 0 for the other, -1 for none.
    """
    p = model.correct_ranges(keypoints)
    ranges, q, beams = returns_in_target_frame(p, T_sensor_target)
    end = -np.sign(beams[:, 0]) if features is None else np.where(features > 0, 1.0, -1.0)
    gap, cosine = target.cap_distance_along_beam(q.T, beams.T, end)
    hit = q + gap[:, None] * beams
    inside = target.radius - np.hypot(hit[:, 1], hit[:, 2])
    trust = taper_weight(cosine - options["min_cosine"], INCIDENCE_TAPER_COS)
    trust *= taper_weight(inside - options["edge_margin_m"], EDGE_TAPER_M)
    return Assignment(
        candidate_feature=(end > 0).astype(int) if features is None else features,
        geometric_weight=trust,
        repeat_group=(end > 0).astype(int),
        keypoint_sigma=keypoints["sigma"],
        residual=gap[:, None],
        range=ranges,
        cos_incidence=cosine,
        data=np.column_stack([p, end]),
        noise=noise,
        gate_sigma=options["gate_sigma"],
    )


assign_first = assign


def residual(model: LidarModel, target: Cylinder) -> ResidualExpression:
    """Return the expression of the distance along the beam over σ; (1)."""

    def weighted_gap(
        R: ArrayOrExpression, t: ArrayOrExpression, d: ArrayOrExpression
    ) -> ArrayOrExpression:
        beam = R.T @ d[:3] / ca.sqrt(ca.dot(d[:3], d[:3]))
        gap, _ = target.cap_distance_along_beam(R.T @ (d[:3] - t), beam, d[3])
        return gap * d[4]

    return weighted_gap
