"""Directions in which a lidar's scan lines leave the outline of a flat target."""

import casadi as ca
import numpy as np

from calib.estimation.residuals.assignment import Assignment, number_repeat_groups
from calib.geometry.polygon import nearest_polygon_edge
from calib.geometry.se3 import invert_pose, transform_points

UNIT, MIN_SIGMA = "rad", None
DATA_COLUMNS = ("dx", "dy", "dz", "ax", "ay", "az", "bx", "by", "bz", "wider", "weight")
MIN_VERTEX_DISTANCE_M = 0.02  # a crossing nearer than this to a vertex may belong to either edge
MIN_SCAN_ANGLE_SINE = 0.2  # an edge more parallel than this to the scan line fixes no crossing


def assign(lidar, target, T_sensor_target, keypoints, options, noise, features=None):
    """Crossings of the outline, each with the edge nearest to where its ray meets the board.

    A crossing lies anywhere between two beams: σ is the step between them over √12, taken across
    the edge. Where the scans of a placement repeat a crossing they have its error in common. What
    the lidar's beams see an outline wider (rig.Lidar.widening) is taken off.
    features (n,): edge of each crossing where it was assigned before, -1 for none.
    """
    T_target_sensor = invert_pose(T_sensor_target)
    ray = lidar.correct_rays(
        keypoints["xyz"], _intersect_board_plane(T_target_sensor, keypoints["xyz"])[1]
    )
    hit, ranges, cosine = _intersect_board_plane(T_target_sensor, ray)
    index, fraction = nearest_polygon_edge(target.vertices, hit[:, :2], features)
    ends = target.outline_edges()[index]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    a, b = (transform_points(T_sensor_target, ends[:, k]) for k in (0, 1))
    normal = np.cross(a, b)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    outwards = -np.sign(normal @ transform_points(T_sensor_target, target.centre[None])[0])
    wider = outwards * lidar.outline_dilation(ranges)
    angle = np.sum(normal * ray, 1) - wider
    across = np.abs(np.sum(normal * np.cross([0.0, 0.0, 1.0], ray), 1))
    clear = np.minimum(fraction, 1 - fraction) * length > MIN_VERTEX_DISTANCE_M
    over = clear & (across > MIN_SCAN_ANGLE_SINE) & (cosine > options["min_cosine"])
    return Assignment(
        candidate_feature=index,
        geometric_weight=over.astype(float),
        repeat_group=number_repeat_groups(index, keypoints["feature_index"]),
        keypoint_sigma=keypoints["sigma"] * np.maximum(across, MIN_SCAN_ANGLE_SINE),
        residual=angle[:, None],
        range=ranges,
        cos_incidence=cosine,
        data=np.column_stack([ray, ends.reshape(-1, 6), wider]),
        noise=noise,
        gate_sigma=options["gate_sigma"],
    )


def _intersect_board_plane(T_target_sensor, ray):
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
