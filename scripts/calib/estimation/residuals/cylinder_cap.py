"""Lidar returns on the flat ends of a cylinder, which alone tell a lidar how far along it sits."""

import casadi as ca
import numpy as np

from calib.estimation.residuals.assignment import Assignment
from calib.estimation.residuals.robust_loss import taper_weight
from calib.estimation.residuals.target_surface import (
    EDGE_TAPER_M,
    INCIDENCE_TAPER_COS,
    returns_in_target_frame,
)

UNIT, MIN_SIGMA = "m", 1e-7
DATA_COLUMNS = ("x", "y", "z", "end", "weight")


def assign(lidar, target, T_sensor_target, keypoints, options, noise, features=None):
    """Returns whose beams meet the end that faces the lidar within its rim; off along the beam.

    features (n,): 1 for the end towards +x, 0 for the other, -1 where a return was assigned to
    nothing before.
    """
    p = lidar.correct_ranges(keypoints["xyz"], keypoints["feature_index"])
    ranges, q, beams = returns_in_target_frame(p, T_sensor_target)
    end = -np.sign(beams[:, 0]) if features is None else np.where(features > 0, 1.0, -1.0)
    gap, cosine = target.cap_distance_along_beam(q.T, beams.T, end)
    met = q + gap[:, None] * beams
    inside = target.radius - np.hypot(met[:, 1], met[:, 2])
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


def residual(lidar, target):
    """How far along the beam a return lies before the end, over σ; (1)."""

    def of(R, t, d):
        beam = R.T @ d[:3] / ca.sqrt(ca.dot(d[:3], d[:3]))
        gap, _ = target.cap_distance_along_beam(R.T @ (d[:3] - t), beam, d[3])
        return gap * d[4]

    return of
