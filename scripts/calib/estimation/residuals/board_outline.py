"""Directions in which a lidar's scan lines leave the outline of a flat target."""

import casadi as ca
import numpy as np

from calib.estimation.residuals.assignment import Assignment, cells
from calib.geometry import polygon, se3

UNIT, ROUNDING = "rad", None
DATA = ("dx", "dy", "dz", "ax", "ay", "az", "bx", "by", "bz", "wider", "weight")
VERTEX_M = 0.02  # a crossing nearer than this to a vertex may belong to either edge
ALONG_SCAN = 0.2  # an edge more parallel than this to the scan line fixes no crossing


def assign(lidar, target, T_sensor_target, keypoints, options, noise):
    """Crossings of the outline, each with the edge nearest to where its ray meets the board.

    A crossing lies anywhere between two beams: σ is the step between them over √12, taken across
    the edge. Where the scans of a placement repeat a crossing they have its error in common. What
    the lidar's beams see an outline wider (rig.Lidar.widening) is taken off.
    """
    T_target_sensor = se3.inverse(T_sensor_target)
    ray = lidar.aimed(keypoints["xyz"], _met(T_target_sensor, keypoints["xyz"])[1])
    hit, ranges, cosine = _met(T_target_sensor, ray)
    index, fraction = polygon.nearest_edge(target.vertices, hit[:, :2])
    ends = target.edges()[index]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    a, b = (se3.transform(T_sensor_target, ends[:, k]) for k in (0, 1))
    normal = np.cross(a, b)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    outwards = -np.sign(normal @ se3.transform(T_sensor_target, target.centre[None])[0])
    wider = outwards * lidar.widening(ranges)
    angle = np.sum(normal * ray, 1) - wider
    across = np.abs(np.sum(normal * np.cross([0.0, 0.0, 1.0], ray), 1))
    clear = np.minimum(fraction, 1 - fraction) * length > VERTEX_M
    over = clear & (across > ALONG_SCAN) & (cosine > options["min_cosine"])
    return Assignment(
        nearest=index,
        trust=over.astype(float),
        cell=cells(index, keypoints["index"]),
        own=keypoints["sigma"] * np.maximum(across, ALONG_SCAN),
        value=angle[:, None],
        range=ranges,
        cosine=cosine,
        numbers=np.column_stack([ray, ends.reshape(-1, 6), wider]),
        noise=noise,
        gate=options["gate_sigma"],
    )


def _met(T_target_sensor, ray):
    """Where rays (n, 3), sensor frame, meet the plane of the target (n, 3), target frame, how far
    off (n,), and the cosine of incidence (n,)."""
    origin, beam = T_target_sensor[:3, 3], ray @ T_target_sensor[:3, :3].T
    steep = np.where(np.abs(beam[:, 2]) > 1e-6, beam[:, 2], 1e-6)
    along = -origin[2] / steep
    return origin + beam * along[:, None], np.abs(along), -beam[:, 2]


def residual(lidar, target):
    """Angle between a ray (lidar frame) and the plane through the lidar and an outline edge, less
    what the outline is seen wider; (1).

    It is what a beam can tell of an edge: the crossing's direction, not its range.
    """

    def of(R, t, d):
        ray, a, b = d[:3], R @ d[3:6] + t, R @ d[6:9] + t
        normal = ca.cross(a, b)
        angle = ca.dot(normal, ray) / ca.sqrt(ca.dot(normal, normal) + 1e-20)
        return (angle - d[9]) * d[10]

    return of
