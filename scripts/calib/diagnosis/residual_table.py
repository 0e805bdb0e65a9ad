"""Rows of residuals.parquet."""

import numpy as np

from calib.diagnosis import solution_json
from calib.estimation.estimate_state import get_local_motion
from calib.estimation.pose_chain import T_sensor_target, deskew_group
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.estimation.residuals.robust_loss import tukey_weight
from calib.geometry.se3 import invert_pose, transform_points
from calib.io.parquet_tables import concatenate_columns
from calib.io.table_schemas import RESIDUALS_SCHEMA


def residual_columns(setup, result):
    """Columns of residuals.parquet; those of views in motion are what is left beside the error of
    their own pose."""
    parts, gate = [], setup.associate_options["gate_sigma"]
    for g, a in zip(setup.groups, result.assignments, strict=True):
        place = setup.placements[g.placement]
        n = len(a.feature)
        k = deskew_group(setup, result.state, g).keypoints
        T = T_sensor_target(setup, result.state, g.sensor, g.placement)
        in_target = transform_points(invert_pose(T), np.nan_to_num(k["xyz"]))
        in_image = RESIDUAL_KINDS[g.kind].UNIT == "px"
        pixel = np.column_stack([k["uv"], np.zeros(n)])
        parts.append(
            {
                "session": np.full(n, place.session),
                "sensor": np.full(n, g.sensor),
                "target": np.full(n, place.target),
                "placement": k["placement"],
                "view": k["view"],
                "is_moving": np.full(n, g.is_moving),
                "speed_mps": np.full(n, target_speed_mps(setup, result.state, g)),
                "kind": np.full(n, g.kind),
                "value": solution_json._pad_to_two_columns(a.residual),
                "sigma": a.sigma,
                "weight": np.where(a.feature >= 0, tukey_weight(a.standardized_norm, gate), 0.0),
                "measured": pixel if in_image else in_target,
                "range_m": a.range,
                "cos_incidence": a.cos_incidence,
                "feature_index": a.feature if g.kind == "pattern_corner" else k["feature_index"],
            }
        )
    return concatenate_columns(parts, RESIDUALS_SCHEMA)


def target_speed_mps(setup, state, group):
    """Speed, m/s, of the middle of a group's target against the robot; 0 in a placement."""
    if not group.is_moving:
        return 0.0
    place = setup.placements[group.placement]
    T = state.mounts.get(place.target, place.T_body_target)
    middle = transform_points(T, setup.targets[place.target].centre)
    velocity = get_local_motion(setup, state, group.placement).velocity
    return float(np.linalg.norm(velocity[:3] + np.cross(velocity[3:], middle)))
