"""Lidar returns against the nearest point of the target's template; paper equation 2."""

from calib.estimation.residuals import nearest_point

UNIT, ROUNDING = "m", 1e-6
DATA = ("x", "y", "z", "tx", "ty", "tz", "weight")
assign, first = nearest_point.against(lambda target: target.points.tree)


def residual(lidar, target):
    """The return minus its template point, over σ; (3)."""
    return nearest_point.residual
