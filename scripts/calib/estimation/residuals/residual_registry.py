"""Kinds of measurement: which part of a target each belongs to, and what it says about the pose.

A kind is one module with
  UNIT            "px", "m" or "rad", of its residuals;
  ROUNDING        of the data, in UNIT: below it no noise is estimated. None where σ is no noise but
                  the step of a scan pattern, which can only turn out larger;
  DATA            names of one measurement's numbers, the last of which is 1/σ: 0 takes it out;
  assign(model, target, T_sensor_target, keypoints, options, noise, features=None) -> Assignment
                  of keypoints (columns) of one sensor, its Camera or rig.Lidar, in one placement;
                  noise: the present Noise, in units of the keypoints' own σ; features (n,): of each
                  measurement where it was assigned before (stage associate), -1 for none;
  residual(model, target) -> function of R (3, 3) and t (3), of T_sensor_target, and of the numbers:
                  a CasADi expression in units of σ;
  first           as assign, where the very first pass differs.

Membership is decided here, for extract and solve alike. To add a kind: write
calib/estimation/residuals/<kind>.py and add it to KINDS.
"""

from calib.estimation.residuals import (
    board_outline,
    cylinder_cap,
    cylinder_limb,
    pattern_corner,
    target_surface,
    template_point,
    template_silhouette,
    template_vertex,
)

RESIDUAL_KINDS = {
    "cylinder_cap": cylinder_cap,
    "pattern_corner": pattern_corner,
    "board_outline": board_outline,
    "cylinder_limb": cylinder_limb,
    "template_point": template_point,
    "template_silhouette": template_silhouette,
    "target_surface": target_surface,
    "template_vertex": template_vertex,
}


def uses_template_points(kind):
    """Whether a measurement's feature is the nearest of a template's points."""
    return hasattr(RESIDUAL_KINDS[kind], "assign_first")


def first_assignment(kind):
    """The function that assigns measurements of a kind before anything was solved."""
    return getattr(RESIDUAL_KINDS[kind], "assign_first", RESIDUAL_KINDS[kind].assign)
