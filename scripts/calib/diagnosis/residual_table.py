"""Rows of residuals.parquet."""

import numpy as np

from calib.diagnosis import solution_json
from calib.estimation import estimate_state, pose_chain
from calib.estimation.residuals import residual_registry
from calib.estimation.residuals.robust_loss import loss_weight
from calib.geometry import se3
from calib.io import parquet_tables, table_schemas


def residuals(setup, result):
    """Columns of residuals.parquet; those of views in motion are what is left beside the error of
    their own pose."""
    parts, gate = [], setup.associate["gate_sigma"]
    for g, a in zip(setup.groups, result.assigned, strict=True):
        place = setup.placements[g.placement]
        n = len(a.feature)
        k = pose_chain.frozen(setup, result.state, g).keypoints
        T = pose_chain.T_sensor_target(setup, result.state, g.sensor, g.placement)
        in_target = se3.transform(se3.inverse(T), np.nan_to_num(k["xyz"]))
        in_image = residual_registry.KINDS[g.kind].UNIT == "px"
        pixel = np.column_stack([k["uv"], np.zeros(n)])
        parts.append(
            {
                "session": np.full(n, place.session),
                "sensor": np.full(n, g.sensor),
                "target": np.full(n, place.target),
                "placement": k["placement"],
                "view": k["view"],
                "moving": np.full(n, g.moving),
                "speed": np.full(n, speed(setup, result.state, g)),
                "kind": np.full(n, g.kind),
                "value": solution_json.pair_of(a.value),
                "sigma": a.sigma,
                "weight": np.where(a.feature >= 0, loss_weight(a.size, gate), 0.0),
                "measured": pixel if in_image else in_target,
                "range": a.range,
                "cosine": a.cosine,
                "index": a.feature if g.kind == "corner" else k["index"],
            }
        )
    return parquet_tables.concatenate(parts, table_schemas.RESIDUALS)


def speed(setup, state, group):
    """Speed, m/s, of the middle of a group's target against the robot; 0 in a placement."""
    if not group.moving:
        return 0.0
    place = setup.placements[group.placement]
    T = state.mounts.get(place.target, place.T_body_target)
    middle = se3.transform(T, setup.targets[place.target].centre)
    velocity = estimate_state.fit_of(setup, state, group.placement).velocity
    return float(np.linalg.norm(velocity[:3] + np.cross(velocity[3:], middle)))
