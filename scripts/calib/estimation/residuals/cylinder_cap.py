"""Lidar returns on the flat ends of a cylinder, which alone tell a lidar how far along it sits."""

import casadi as ca
import numpy as np

from calib.estimation.residuals.assignment import Assignment
from calib.estimation.residuals.robust_loss import taper
from calib.estimation.residuals.target_surface import TAPER_COSINE, TAPER_M, in_target

UNIT, ROUNDING = "m", 1e-7
DATA = ("x", "y", "z", "end", "weight")


def assign(lidar, target, T_sensor_target, keypoints, options, noise):
    """Returns whose beams meet the end that faces the lidar within its rim; off along the beam."""
    p = lidar.mended(keypoints["xyz"], keypoints["index"])
    ranges, q, beams = in_target(p, T_sensor_target)
    end = -np.sign(beams[:, 0])
    gap, cosine = target.cap_gap(q.T, beams.T, end)
    met = q + gap[:, None] * beams
    inside = target.radius - np.hypot(met[:, 1], met[:, 2])
    trust = taper(cosine - options["min_cosine"], TAPER_COSINE)
    trust *= taper(inside - options["edge_margin_m"], TAPER_M)
    return Assignment(
        nearest=(end > 0).astype(int),
        trust=trust,
        cell=(end > 0).astype(int),
        own=keypoints["sigma"],
        value=gap[:, None],
        range=ranges,
        cosine=cosine,
        numbers=np.column_stack([p, end]),
        noise=noise,
        gate=options["gate_sigma"],
    )


def residual(lidar, target):
    """How far along the beam a return lies before the end, over σ; (1)."""

    def of(R, t, d):
        beam = R.T @ d[:3] / ca.sqrt(ca.dot(d[:3], d[:3]))
        gap, _ = target.cap_gap(R.T @ (d[:3] - t), beam, d[3])
        return gap * d[4]

    return of
