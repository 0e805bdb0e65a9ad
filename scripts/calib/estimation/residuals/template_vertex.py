"""Corners of a board's outline that ICP laid on a scan, against the outline's own; equation 2."""

from scipy.spatial import cKDTree

from calib.estimation.residuals.nearest_point import (
    make_nearest_point_assigns,
    template_point_residual,
)

UNIT, MIN_SIGMA = "m", 1e-6
DATA_COLUMNS = ("x", "y", "z", "tx", "ty", "tz", "weight")
assign, assign_first = make_nearest_point_assigns(lambda target: cKDTree(target.outline_points()))


def residual(lidar, target):
    """The corner minus the outline's, over σ; (3)."""
    return template_point_residual
