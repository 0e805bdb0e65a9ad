"""Points against the nearest of a set of target points: the paper's correspondence search, III-D.

The very first pass lays the centroid of the target's points on that of the measured ones, because
a wrong guess shifts the whole target first.
"""

import numpy as np

from calib.estimation.residuals.assignment import Assignment
from calib.geometry import se3


def assign(tree, T_sensor_target, keypoints, options, noise, shift):
    """Measured points, each with the nearest of the tree's points (m, 3), target frame.

    shift (3,): by which the measured points are moved, in the target frame, for the search alone.
    """
    p = keypoints["xyz"]
    q = se3.transform(se3.inverse(T_sensor_target), p)
    distance, near = tree.query(q + shift)
    reach = options["gate_sigma"] * noise.total * keypoints["sigma"]
    return Assignment(
        nearest=np.where(distance < reach, near, -1),
        trust=np.ones(len(p)),
        cell=np.arange(len(p)),
        own=keypoints["sigma"],
        value=q - tree.data[near],
        range=np.linalg.norm(p, axis=1),
        cosine=np.ones(len(p)),
        numbers=np.column_stack([p, tree.data[near]]),
        noise=noise,
        gate=options["gate_sigma"],
    )


def centred(tree, T_sensor_target, keypoints):
    """Shift (3,) that lays the measured points' centroid on that of the tree's points."""
    q = se3.transform(se3.inverse(T_sensor_target), keypoints["xyz"])
    return tree.data.mean(0) - q.mean(0)


def against(tree_of):
    """(assign, first) of a kind whose measurements belong to points of tree_of(target)."""

    def assign_to(lidar, target, T_sensor_target, keypoints, options, noise):
        return assign(tree_of(target), T_sensor_target, keypoints, options, noise, 0.0)

    def first(lidar, target, T_sensor_target, keypoints, options, noise):
        tree = tree_of(target)
        shift = centred(tree, T_sensor_target, keypoints)
        return assign(tree, T_sensor_target, keypoints, options, noise, shift)

    return assign_to, first


def residual(R, t, d):
    """Paper equation 2: a measured point minus the target's point it belongs to, over σ; (3)."""
    return (d[:3] - R @ d[3:6] - t) * d[6]
