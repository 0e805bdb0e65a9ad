"""Lidar returns against the nearest point of the target's template; paper equation 2."""

from calib.kinds import nearest

UNIT, ROUNDING = "m", 1e-6
DATA = ("x", "y", "z", "tx", "ty", "tz", "weight")


def assign(lidar, target, T_sensor_target, keypoints, options, scale):
    """Every return with the nearest template point."""
    tree = target.points.tree
    return nearest.assign(tree, T_sensor_target, keypoints, options, scale, 0.0)


def first(lidar, target, T_sensor_target, keypoints, options, scale):
    """As assign, with the centroids laid on each other."""
    tree = target.points.tree
    shift = nearest.centred(tree, T_sensor_target, keypoints)
    return nearest.assign(tree, T_sensor_target, keypoints, options, scale, shift)


def residual(lidar, target):
    """The return minus its template point, over σ; (3)."""
    return nearest.residual
