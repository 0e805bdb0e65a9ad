"""Points against the nearest of a set of target points: the paper's correspondence search, III-D.

The very first pass lays the centroid of the target's points on that of the measured ones, because
a wrong guess shifts the whole target first.
"""

import numpy as np

from calib.estimation.residuals.assignment import Assignment
from calib.geometry.se3 import invert_pose, transform_points


def assign_nearest_points(tree, T_sensor_target, keypoints, options, noise, shift, features=None):
    """Measured points, each with the nearest of the tree's points (m, 3), target frame.

    shift (3,): by which the measured points are moved, in the target frame, for the search alone.
    features (n,): point of each where it was assigned before, -1 for none.
    """
    p = keypoints["xyz"]
    q = transform_points(invert_pose(T_sensor_target), p)
    near = features
    if features is None:
        distance, near = tree.query(q + shift)
        reach = options["gate_sigma"] * noise.total * keypoints["sigma"]
        features = np.where(distance < reach, near, -1)
    return Assignment(
        candidate_feature=features,
        geometric_weight=np.ones(len(p)),
        repeat_group=np.arange(len(p)),
        keypoint_sigma=keypoints["sigma"],
        residual=q - tree.data[near],
        range=np.linalg.norm(p, axis=1),
        cos_incidence=np.ones(len(p)),
        data=np.column_stack([p, tree.data[near]]),
        noise=noise,
        gate_sigma=options["gate_sigma"],
    )


def centroid_shift(tree, T_sensor_target, keypoints):
    """Shift (3,) that lays the measured points' centroid on that of the tree's points."""
    q = transform_points(invert_pose(T_sensor_target), keypoints["xyz"])
    return tree.data.mean(0) - q.mean(0)


def make_nearest_point_assigns(get_tree):
    """(assign, first) of a kind whose measurements belong to points of tree_of(target)."""

    def assign_to(lidar, target, T_sensor_target, keypoints, options, noise, features=None):
        return assign_nearest_points(
            get_tree(target), T_sensor_target, keypoints, options, noise, 0.0, features
        )

    def first(lidar, target, T_sensor_target, keypoints, options, noise):
        tree = get_tree(target)
        shift = centroid_shift(tree, T_sensor_target, keypoints)
        return assign_nearest_points(tree, T_sensor_target, keypoints, options, noise, shift)

    return assign_to, first


def template_point_residual(R, t, d):
    """Paper equation 2: a measured point minus the target's point it belongs to, over σ; (3)."""
    return (d[:3] - R @ d[3:6] - t) * d[6]
