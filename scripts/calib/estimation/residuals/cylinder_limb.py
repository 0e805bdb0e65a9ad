"""The side of a cylinder in an image: rays that touch it, exact for every camera model."""

import casadi as ca
import numpy as np

from calib.estimation.residuals.assignment import Assignment, number_repeat_groups
from calib.estimation.residuals.robust_loss import taper_weight

UNIT, MIN_SIGMA = "px", 1e-2
DATA_COLUMNS = ("dx", "dy", "dz", "side", "px_per_m", "weight")
END_TAPER_M = 0.02  # along the axis, over which the weight of a contour point fades in from an end
N_LIMB_PIECES = 8  # of a limb, each with an error of its own that every image repeats
RAY_STEP_RAD = 1e-4  # between the rays from which the scale of the image is taken


def assign(camera, target, T_sensor_target, keypoints, options, noise, features=None):
    """Contour points on the side of the cylinder, away from its ends.

    A ray touches the cylinder when its distance from the axis is the radius, on the side (+1, -1)
    of the axis where the contour point was found. In pixels that is the distance of the point from
    the projected limb. features (n,): 0, or -1 where a point was assigned to nothing before.
    """
    ray, valid = camera.unproject(keypoints["uv"])
    axis, centre = T_sensor_target[:3, 0], T_sensor_target[:3, 3]
    normal = np.cross(axis, ray)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    side = keypoints["feature_index"].astype(float)
    gap = side * (normal @ centre) - target.radius
    # The foot of the ray on the axis' normal plane: how far along both lines they come closest.
    across = np.cross(normal, axis)
    depth = (across @ centre) / np.sum(across * ray, 1)
    along = ray @ axis * depth - centre @ axis
    px_per_m = _pixels_per_radian(camera, ray, normal) / np.maximum(np.abs(depth), 1e-6)
    value = gap * px_per_m
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


def _limb_piece_number(share):
    """Number (n,) of the piece of the limb, from places along the axis as shares of its length."""
    return np.floor(N_LIMB_PIECES * np.clip(np.nan_to_num(share), -0.5, 0.5))


def _pixels_per_radian(camera, ray, normal):
    """Pixels (n,) per radian where rays (n, 3) point, towards unit normals (n, 3)."""
    beside = [camera.project(ray + side * RAY_STEP_RAD * normal)[0] for side in (-1, 1)]
    return np.linalg.norm(beside[1] - beside[0], axis=1) / (2 * RAY_STEP_RAD)


def residual(camera, target):
    """Distance of a ray from the cylinder's axis on its side, less the radius, px over σ; (1)."""

    def of(R, t, d):
        normal = ca.cross(R[:, 0], d[:3])
        distance = d[3] * ca.dot(normal, t) / ca.sqrt(ca.dot(normal, normal) + 1e-20)
        return (distance - target.radius) * d[4] * d[5]

    return of
