"""Rows of residuals.parquet."""

from typing import Any

import numpy as np

from calib.estimation.estimate_state import State, get_local_motion
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.measurement_assignment import pad_to_two_columns
from calib.estimation.pose_chain import T_sensor_target, deskew_group
from calib.estimation.residuals.assignment import Assignment
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.estimation.residuals.robust_loss import tukey_weight
from calib.geometry.se3 import invert_pose, transform_points
from calib.io.parquet_tables import concatenate_columns
from calib.io.table_schemas import RESIDUALS_SCHEMA


def residual_columns(setup: Setup, result: EstimationResult) -> dict[str, Any]:
    """Return the columns of residuals.parquet.

    Residuals of moving views are relative to the estimated error of their own pose.
    """
    pairs = zip(setup.groups, result.assignments, strict=True)
    parts = [_group_columns(setup, result.state, group, a) for group, a in pairs]
    return concatenate_columns(parts, RESIDUALS_SCHEMA)


def _group_columns(
    setup: Setup, state: State, group: MeasurementGroup, assignment: Assignment
) -> dict[str, np.ndarray]:
    place, n = setup.placements[group.placement], len(assignment.feature)
    keypoints = deskew_group(setup, state, group).keypoints
    if RESIDUAL_KINDS[group.kind].UNIT == "px":
        measured = np.column_stack([keypoints["uv"], np.zeros(n)])
    else:
        T = T_sensor_target(setup, state, group.sensor, group.placement)
        measured = transform_points(invert_pose(T), np.nan_to_num(keypoints["xyz"]))
    weight = tukey_weight(assignment.standardized_norm, setup.associate_options["gate_sigma"])
    is_corner = group.kind == "pattern_corner"
    return {
        "session": np.full(n, place.session),
        "sensor": np.full(n, group.sensor),
        "target": np.full(n, place.target),
        "placement": keypoints["placement"],
        "view": keypoints["view"],
        "is_moving": np.full(n, group.is_moving),
        "speed_mps": np.full(n, target_speed_mps(setup, state, group)),
        "kind": np.full(n, group.kind),
        "value": pad_to_two_columns(assignment.residual),
        "sigma": assignment.sigma,
        "weight": np.where(assignment.feature >= 0, weight, 0.0),
        "measured": measured,
        "range_m": assignment.range,
        "cos_incidence": assignment.cos_incidence,
        "feature_index": assignment.feature if is_corner else keypoints["feature_index"],
    }


def target_speed_mps(setup: Setup, state: State, group: MeasurementGroup) -> float:
    """Return the speed, m/s, of the centre of a group's target in the robot frame; 0 if still."""
    if not group.is_moving:
        return 0.0
    place = setup.placements[group.placement]
    T_body_target = state.mounts.get(place.target, place.T_body_target)
    centre = transform_points(T_body_target, setup.targets[place.target].centre)
    velocity = get_local_motion(setup, state, group.placement).velocity
    return float(np.linalg.norm(velocity[:3] + np.cross(velocity[3:], centre)))
