"""Corners of a board's outline that ICP laid on a scan, against the outline's own; equation 2."""

from scipy.spatial import cKDTree

from calib.kinds import nearest

UNIT, ROUNDING = "m", 1e-6
DATA = ("x", "y", "z", "tx", "ty", "tz", "weight")


def assign(lidar, target, T_sensor_target, keypoints, options, scale):
    """Every corner with the nearest of the outline."""
    tree = cKDTree(target.outline_points())
    return nearest.assign(tree, T_sensor_target, keypoints, options, scale, 0.0)


def first(lidar, target, T_sensor_target, keypoints, options, scale):
    """As assign, with the centroids laid on each other."""
    tree = cKDTree(target.outline_points())
    shift = nearest.centred(tree, T_sensor_target, keypoints)
    return nearest.assign(tree, T_sensor_target, keypoints, options, scale, shift)


def residual(lidar, target):
    """The corner minus the outline's, over σ; (3)."""
    return nearest.residual
