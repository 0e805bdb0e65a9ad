"""Lidar returns on the surface of a target, compared with its exact geometry."""

import casadi as ca
import numpy as np

from calib.estimation.residuals.assignment import Assignment, cells
from calib.estimation.residuals.robust_loss import taper
from calib.geometry import se3

UNIT, ROUNDING = "m", 1e-7
DATA = ("x", "y", "z", "weight")
TAPER_M, TAPER_COSINE = 0.01, 0.1  # over which the weight of a return fades in from a limit


def assign(lidar, target, T_sensor_target, keypoints, options, noise):
    """Returns that lie on the target: over its surface, near it, and not at a grazing angle.

    The residual is along the beam, where the noise is: a distance across the surface would shrink,
    and with it the cost, when the target turns away, however true. Towards the rim and towards
    grazing a return loses its weight, so that nothing jumps when it comes or goes there.
    """
    p = lidar.mended(keypoints["xyz"], keypoints["index"])
    ranges, q, beams = in_target(p, T_sensor_target)
    gap, cosine = target.gap(q.T, beams.T)
    trust = taper(cosine - options["min_cosine"], TAPER_COSINE)
    # Where the beam meets the surface, which noise along the beam does not move.
    met = q + gap[:, None] * beams
    trust *= taper(target.depth(met) - options["edge_margin_m"], TAPER_M)
    return Assignment(
        nearest=np.zeros(len(p), int),
        trust=trust,
        cell=cells(keypoints["index"]),
        own=keypoints["sigma"],
        value=gap[:, None],
        range=ranges,
        cosine=cosine,
        numbers=p,
        noise=noise,
        gate=options["gate_sigma"],
    )


def in_target(p, T_sensor_target):
    """Ranges (n,) of returns p (n, 3), and they and their unit beams (n, 3) in the target frame."""
    ranges = np.linalg.norm(p, axis=1)
    T_target_sensor = se3.inverse(T_sensor_target)
    beams = p @ T_target_sensor[:3, :3].T / np.maximum(ranges, 1e-9)[:, None]
    return ranges, se3.transform(T_target_sensor, p), beams


def residual(lidar, target):
    """How far along the beam a return lies before the surface, over σ; (1)."""

    def of(R, t, d):
        gap, _ = target.gap(R.T @ (d[:3] - t), R.T @ d[:3] / ca.sqrt(ca.dot(d[:3], d[:3])))
        return gap * d[3]

    return of
