"""Lidar returns against the nearest point of the target's template; paper equation 2."""

from calib.kinds import nearest

UNIT, ROUNDING = "m", 1e-6
DATA = ("x", "y", "z", "tx", "ty", "tz", "weight")
assign, first = nearest.against(lambda target: target.points.tree)


def residual(lidar, target):
    """The return minus its template point, over σ; (3)."""
    return nearest.residual
