"""Directions in which a lidar's scan lines leave the outline of a board.

Residual: the angle between the ray d of a crossing (halfway between two beams) and the plane
through the lidar and an edge (a, b), less the angle by which the lidar sees outlines too wide,
    r = n · d - dilation,   n = (Ra + t) × (Rb + t) / |(Ra + t) × (Rb + t)|.
Of a board that is not flat, a and b lie on the tangent of its edge at the crossing.
It takes the place of the corners of a scan's outline (template_vertex, equation 2): a beam
determines the direction of an edge, not its range.
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
)
from calib.geometry.numpy_or_casadi import ArrayOrExpression
from calib.geometry.polygon import nearest_polygon_edge
from calib.geometry.se3 import invert_pose, transform_points
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.board import Board

UNIT, MIN_SIGMA = "rad", None
DATA_COLUMNS = ("dx", "dy", "dz", "ax", "ay", "az", "bx", "by", "bz", "wider", "weight")
USES_TEMPLATE_POINTS = False
MIN_VERTEX_DISTANCE_M = 0.02  # a crossing nearer to a vertex may belong to either edge
MIN_SCAN_ANGLE_SINE = 0.2  # an edge more parallel to the scan line determines no crossing


def assign(
    model: LidarModel,
    target: Board,
    T_sensor_target: np.ndarray,
    keypoints: Keypoints,
    *,
    options: Mapping[str, Any],
    noise: Noise,
    features: np.ndarray | None = None,
) -> Assignment:
    """Assign every crossing to the edge nearest to where its ray meets the board.

    A crossing lies anywhere between two beams: σ is their distance over √12, taken across the
    edge. Repetitions of a crossing in the scans of a placement have this error in common.
    features: edges, numbered as outline_edges.
    """
    T_target_sensor, ray = invert_pose(T_sensor_target), keypoints["xyz"]
    ray = model.correct_rays(ray, _intersect_board_plane(T_target_sensor, ray)[1])
    hit, ranges, cosine = _intersect_board_plane(T_target_sensor, ray)
    index, fraction = nearest_polygon_edge(target.vertices, hit[:, :2], features)
    ends = target.edge_tangents(index, fraction)
    a, b = (transform_points(T_sensor_target, ends[:, k]) for k in (0, 1))
    normal = np.cross(a, b)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    outwards = -np.sign(normal @ transform_points(T_sensor_target, target.centre[None])[0])
    dilation = outwards * model.outline_dilation(ranges)
    across = np.abs(np.sum(normal * np.cross([0.0, 0.0, 1.0], ray), 1))
    off_vertices, min_cosine = _is_off_vertices(ends, fraction), options["min_cosine"]
    admitted = off_vertices & (across > MIN_SCAN_ANGLE_SINE) & (cosine > min_cosine)
    return Assignment(
        candidate_feature=index,
        geometric_weight=admitted.astype(float),
        repeat_group=number_repeat_groups(index, keypoints["feature_index"]),
        keypoint_sigma=keypoints["sigma"] * np.maximum(across, MIN_SCAN_ANGLE_SINE),
        residual=(np.sum(normal * ray, 1) - dilation)[:, None],
        range=ranges,
        cos_incidence=cosine,
        data=np.column_stack([ray, ends.reshape(-1, 6), dilation]),
        noise=noise,
        gate_sigma=options["gate_sigma"],
    )


assign_first = assign


def residual(model: LidarModel, target: Board) -> ResidualExpression:
    """Return the expression of the angle over σ; (1)."""

    def weighted_angle(
        R: ArrayOrExpression, t: ArrayOrExpression, d: ArrayOrExpression
    ) -> ArrayOrExpression:
        normal = ca.cross(R @ d[3:6] + t, R @ d[6:9] + t)
        angle = ca.dot(normal, d[:3]) / ca.sqrt(ca.dot(normal, normal) + 1e-20)
        return (angle - d[9]) * d[10]

    return weighted_angle


def _is_off_vertices(ends: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Return which crossings (n,), at fractions (n,) of edges (n, 2, 3), are off the vertices."""
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return np.minimum(fraction, 1 - fraction) * length > MIN_VERTEX_DISTANCE_M


def _intersect_board_plane(
    T_target_sensor: np.ndarray, ray: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Intersect rays (n, 3), sensor frame, with the plane of the board.

    Returns points (n, 3), target frame, their ranges (n,), and the cosine of incidence (n,).
    """
    origin, beam = T_target_sensor[:3, 3], ray @ T_target_sensor[:3, :3].T
    steep = np.where(np.abs(beam[:, 2]) > 1e-6, beam[:, 2], 1e-6)
    along = -origin[2] / steep
    return origin + beam * along[:, None], np.abs(along), -beam[:, 2]
