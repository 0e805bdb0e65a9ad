"""Lidar returns on the surface of a target, compared with its exact geometry."""

import casadi as ca
import numpy as np

from calib.estimation.residuals.assignment import Assignment, number_repeat_groups
from calib.estimation.residuals.robust_loss import taper_weight
from calib.geometry.se3 import invert_pose, transform_points

UNIT, MIN_SIGMA = "m", 1e-7
DATA_COLUMNS = ("x", "y", "z", "weight")
EDGE_TAPER_M, INCIDENCE_TAPER_COS = (
    0.01,
    0.1,
)  # over which the weight of a return fades in from a limit


def assign(lidar, target, T_sensor_target, keypoints, options, noise, features=None):
    """Returns that lie on the target: over its surface, near it, and not at a grazing angle.

    The residual is along the beam, where the noise is: a distance across the surface would shrink,
    and with it the cost, when the target turns away, however true. Towards the rim and towards
    grazing a return loses its weight, so that nothing jumps when it comes or goes there.
    features (n,): 0, or -1 where a return was assigned to nothing before.
    """
    p = lidar.correct_ranges(keypoints["xyz"], keypoints["feature_index"])
    ranges, q, beams = returns_in_target_frame(p, T_sensor_target)
    gap, cosine = target.distance_along_beam(q.T, beams.T)
    trust = taper_weight(cosine - options["min_cosine"], INCIDENCE_TAPER_COS)
    # Where the beam meets the surface, which noise along the beam does not move.
    met = q + gap[:, None] * beams
    trust *= taper_weight(target.distance_inside_rim(met) - options["edge_margin_m"], EDGE_TAPER_M)
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


def returns_in_target_frame(p, T_sensor_target):
    """Ranges (n,) of returns p (n, 3), and they and their unit beams (n, 3) in the target frame."""
    ranges = np.linalg.norm(p, axis=1)
    T_target_sensor = invert_pose(T_sensor_target)
    beams = p @ T_target_sensor[:3, :3].T / np.maximum(ranges, 1e-9)[:, None]
    return ranges, transform_points(T_target_sensor, p), beams


def residual(lidar, target):
    """How far along the beam a return lies before the surface, over σ; (1)."""

    def of(R, t, d):
        gap, _ = target.distance_along_beam(
            R.T @ (d[:3] - t), R.T @ d[:3] / ca.sqrt(ca.dot(d[:3], d[:3]))
        )
        return gap * d[3]

    return of
