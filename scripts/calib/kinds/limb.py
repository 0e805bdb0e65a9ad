"""The side of a cylinder in an image: rays that touch it, exact for every camera model."""

import casadi as ca
import numpy as np

from calib.kinds.assignment import Assignment, taper

UNIT, ROUNDING = "px", 1e-2
DATA = ("dx", "dy", "dz", "side", "px_per_m", "weight")
TAPER_M = 0.02  # along the axis, over which the weight of a contour point fades in from an end
STEP_PX = 0.1  # between the pixels from which the scale of the image is taken


def assign(camera, target, T_sensor_target, keypoints, options, scale):
    """Contour points on the side of the cylinder, away from its ends.

    A ray touches the cylinder when its distance from the axis is the radius, on the side (+1, -1)
    of the axis where the contour point was found. In pixels that is the distance of the point from
    the projected limb.
    """
    ray, valid = camera.unproject(keypoints["uv"])
    axis, centre = T_sensor_target[:3, 0], T_sensor_target[:3, 3]
    normal = np.cross(axis, ray)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    side = keypoints["index"].astype(float)
    gap = side * (normal @ centre) - target.radius
    # The foot of the ray on the axis' normal plane: how far along both lines they come closest.
    across = np.cross(normal, axis)
    depth = (across @ centre) / np.sum(across * ray, 1)
    along = ray @ axis * depth - centre @ axis
    px_per_m = _px_per_rad(camera, keypoints["uv"], ray, normal) / np.maximum(np.abs(depth), 1e-6)
    value = gap * px_per_m
    trust = taper(target.length / 2 - options["edge_margin_m"] - np.abs(along), TAPER_M)
    over = (trust > 0) & valid & (depth > 0)
    sigma = scale * keypoints["sigma"] / np.sqrt(np.where(over, trust, 1.0))
    member = over & (np.abs(value) < options["gate_sigma"] * sigma)
    numbers = np.column_stack([ray, side, px_per_m])
    touching = np.sqrt(np.clip(1 - (normal @ centre) ** 2 / (centre @ centre), 0, 1))
    feature = np.where(member, 0, -1)
    return Assignment(feature, over, sigma, value[:, None], depth, touching, numbers)


def _px_per_rad(camera, uv, ray, normal):
    """Pixels (n,) per radian at uv (n, 2), where ray (n, 3) points, towards unit normals (n, 3)."""
    right, down = (camera.unproject(uv + STEP_PX * step)[0] - ray for step in np.eye(2))
    along_u, along_v = (np.sum(d * normal, 1) / STEP_PX for d in (right, down))
    return 1 / np.maximum(np.hypot(along_u, along_v), 1e-12)


def residual(camera, target):
    """Distance of a ray from the cylinder's axis on its side, less the radius, px over σ; (1)."""

    def of(R, t, d):
        normal = ca.cross(R[:, 0], d[:3])
        distance = d[3] * ca.dot(normal, t) / ca.sqrt(ca.dot(normal, normal) + 1e-20)
        return (distance - target.radius) * d[4] * d[5]

    return of
