"""Assign measurements to features of their targets at an estimate."""

from collections.abc import Callable, Sequence

import numpy as np

from calib.estimation.estimate_state import State
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.noise.noise_model import noise_key
from calib.estimation.pose_chain import (
    T_sensor_target,
    deskew_group,
    model_with_corrections,
    target_with_corrections,
)
from calib.estimation.residuals.assignment import Assignment
from calib.estimation.residuals.residual_registry import (
    RESIDUAL_KINDS,
    uses_template_points,
)


def assign_measurements(setup: Setup, state: State) -> list[Assignment]:
    """Return the Assignment of every group at the current estimate."""
    return [_assign_group(setup, state, g, RESIDUAL_KINDS[g.kind].assign) for g in setup.groups]


def assign_at_initial_guess(setup: Setup, state: State) -> list[Assignment]:
    """Return the Assignment of every group before anything is solved.

    Features that stage associate assigned are kept; the others are assigned here.
    """
    out = []
    for g in setup.groups:
        if g.initial_features is None:
            out.append(_assign_group(setup, state, g, RESIDUAL_KINDS[g.kind].assign_first))
        else:
            assign = RESIDUAL_KINDS[g.kind].assign
            out.append(_assign_group(setup, state, g, assign, features=g.initial_features))
    return out


def _assign_group(
    setup: Setup,
    state: State,
    group: MeasurementGroup,
    assign: Callable[..., Assignment],
    **features: np.ndarray,
) -> Assignment:
    group = deskew_group(setup, state, group)
    return assign(
        model_with_corrections(setup, state, group),
        target_with_corrections(setup, state, setup.placements[group.placement].target),
        T_sensor_target(setup, state, group.sensor, group.placement),
        group.keypoints,
        options=setup.associate_options,
        noise=state.noise[noise_key(group)],
        **features,
    )


def with_noise_of(
    setup: Setup, state: State, assignments: Sequence[Assignment]
) -> list[Assignment]:
    """Return the Assignments with the noise of the State."""
    return [
        a.with_noise(state.noise[noise_key(g)])
        for g, a in zip(setup.groups, assignments, strict=True)
    ]


def count_reassignments(
    setup: Setup, before: Sequence[Assignment], after: Sequence[Assignment]
) -> int:
    """Count the measurements that became inliers or outliers, or changed their feature.

    The nearest template point changes as long as anything moves: it is not counted. Nor are moving
    views: they weigh little, and points at the edge of their gates come and go for long.
    """
    total = 0
    for g, b, a in zip(setup.groups, before, after, strict=True):
        if g.is_moving:
            continue
        has_new_feature = (a.feature != b.feature) & (not uses_template_points(g.kind))
        total += np.sum(has_new_feature | ((a.feature >= 0) != (b.feature >= 0)))
    return int(total)


def pad_to_two_columns(residual: np.ndarray) -> np.ndarray:
    """Return residuals (n, k) as tables hold them, (n, 2): (u, v), or (a distance, 0)."""
    if residual.shape[1] == 2:
        return residual
    distance = residual[:, 0] if residual.shape[1] == 1 else np.linalg.norm(residual, axis=1)
    return np.column_stack([distance, np.zeros(len(residual))])
