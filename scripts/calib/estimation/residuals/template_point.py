"""Lidar returns against the nearest point of the target's template; paper equation 2."""

from calib.estimation.residuals.nearest_point import (
    make_nearest_point_assigns,
    template_point_residual,
)

UNIT, MIN_SIGMA = "m", 1e-6
DATA_COLUMNS = ("x", "y", "z", "tx", "ty", "tz", "weight")
assign, assign_first = make_nearest_point_assigns(lambda target: target.point_template.kd_tree)


def residual(lidar, target):
    """The return minus its template point, over σ; (3)."""
    return template_point_residual
