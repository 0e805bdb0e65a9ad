"""Lidar returns on the surface of a target, compared with its exact geometry.

Residual: the distance along the beam u = p/|p| from a return p to the surface,
    r = gap(Rᵀ(p - t), Rᵀu),
where gap is distance_along_beam of the shape, the same lines for arrays and expressions. It
replaces the paper's nearest template point (equation 2). Along the beam, because the noise is
there: a distance across the surface would shrink if the target turned away from the beam.
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
from calib.geometry.se3 import invert_pose, transform_points
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.board import Board
from calib.targets.cylinder import Cylinder

UNIT, MIN_SIGMA = "m", 1e-7
DATA_COLUMNS = ("x", "y", "z", "weight")
USES_TEMPLATE_POINTS = False
EDGE_TAPER_M = 0.01  # over which the weight of a return rises from the rim
INCIDENCE_TAPER_COS = 0.1  # over which the weight of a return rises from grazing incidence


def assign(
    model: LidarModel,
    target: Board | Cylinder,
    T_sensor_target: np.ndarray,
    keypoints: Keypoints,
    *,
    options: Mapping[str, Any],
    noise: Noise,
    features: np.ndarray | None = None,
) -> Assignment:
    """Assign returns over the surface of the target, near it and not at a grazing angle.

    Towards the rim and towards grazing incidence a return loses its weight, so that the cost does
    not jump when it comes or goes there. features: 0, or -1 for none.
    """
    p = model.correct_ranges(keypoints)
    ranges, q, beams = returns_in_target_frame(p, T_sensor_target)
    gap, cosine = target.distance_along_beam(q.T, beams.T)
    trust = taper_weight(cosine - options["min_cosine"], INCIDENCE_TAPER_COS)
    # Where the beam meets the surface: noise along the beam does not move this point.
    hit = q + gap[:, None] * beams
    trust *= taper_weight(target.distance_inside_rim(hit) - options["edge_margin_m"], EDGE_TAPER_M)
    if isinstance(target, Board):
        spot = model.spot_radius(ranges)
        trust = np.where(target.is_left_out(hit, spot), 0.0, trust)
        if model.dark_ranges:
            p = _correct_dark_ranges(model, target, p, hit, spot)
            ranges, q, beams = returns_in_target_frame(p, T_sensor_target)
            gap, cosine = target.distance_along_beam(q.T, beams.T)
    return Assignment(
        candidate_feature=np.zeros(len(p), int) if features is None else features,
        geometric_weight=trust,
        repeat_group=number_repeat_groups(keypoints["feature_index"]),
        keypoint_sigma=keypoints["sigma"],
        residual=gap[:, None],
        range=ranges,
        cos_incidence=cosine,
        data=p,
        noise=noise,
        gate_sigma=options["gate_sigma"],
    )


assign_first = assign


def residual(model: LidarModel, target: Board | Cylinder) -> ResidualExpression:
    """Return the expression of the distance along the beam over σ; (1)."""

    def weighted_gap(
        R: ArrayOrExpression, t: ArrayOrExpression, d: ArrayOrExpression
    ) -> ArrayOrExpression:
        gap, _ = target.distance_along_beam(
            R.T @ (d[:3] - t), R.T @ d[:3] / ca.sqrt(ca.dot(d[:3], d[:3]))
        )
        return gap * d[3]

    return weighted_gap


def _correct_dark_ranges(
    model: LidarModel, board: Board, p: np.ndarray, hit: np.ndarray, spot_radius: np.ndarray
) -> np.ndarray:
    """Return the returns p (n, 3) without what dark parts of a board add to their ranges.

    By where their beams hit it (n, 3): noise along a beam does not move the dark share of its spot.
    """
    excess = board.pattern_darkness(hit, spot_radius) @ np.array(model.dark_ranges)
    return p * (1 - excess / np.maximum(np.linalg.norm(p, axis=1), 1e-9))[:, None]


def returns_in_target_frame(
    p: np.ndarray, T_sensor_target: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the ranges (n,) of returns p (n, 3), and returns and beams (n, 3) in target frame."""
    ranges = np.linalg.norm(p, axis=1)
    T_target_sensor = invert_pose(T_sensor_target)
    beams = p @ T_target_sensor[:3, :3].T / np.maximum(ranges, 1e-9)[:, None]
    return ranges, transform_points(T_target_sensor, p), beams
