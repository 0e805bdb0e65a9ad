"""Corners of a board's outline that ICP laid on a scan, against the outline's own; equation 2."""

from scipy.spatial import cKDTree

from calib.estimation.residuals import nearest_point

UNIT, ROUNDING = "m", 1e-6
DATA = ("x", "y", "z", "tx", "ty", "tz", "weight")
assign, first = nearest_point.against(lambda target: cKDTree(target.outline_points()))


def residual(lidar, target):
    """The corner minus the outline's, over σ; (3)."""
    return nearest_point.residual
