"""Linearize the residuals of one group: by a sensor's model, by the target, by the pose."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from calib.estimation import pose_chain
from calib.estimation.estimate_state import State
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.noise.noise_model import noise_key
from calib.estimation.residuals.assignment import Assignment
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS

FINITE_STEP_M = 1e-6
FINITE_STEP_RATIO = 1e-6  # of angles, rad, and of relative changes


@dataclass(frozen=True)
class GroupLinearization:
    """A group at the current estimate.

    model: its sensor's, with all corrections applied; J_pose: (k, 6, n) derivatives of its
    standardized residuals by the right perturbation of T_sensor_target, or None if not known.
    """

    setup: Setup
    state: State
    model: Any  # CameraModel or LidarModel, whichever the correction in question is about
    group: MeasurementGroup
    assignment: Assignment
    J_pose: np.ndarray | None

    @cached_property
    def target(self) -> Any:
        """Return the target's shape, with all corrections applied."""
        name = self.setup.placements[self.group.placement].target
        return pose_chain.target_with_corrections(self.setup, self.state, name)

    @property
    def pose_derivative(self) -> np.ndarray:
        """Return the derivatives (6, k, n) by the right perturbation of T_sensor_target."""
        if self.J_pose is None:
            raise ValueError("this group was linearized without its pose")
        return np.swapaxes(self.J_pose, 0, 1)

    @cached_property
    def T_sensor_target(self) -> np.ndarray:
        """Return the current pose (4, 4)."""
        g = self.group
        return pose_chain.T_sensor_target(self.setup, self.state, g.sensor, g.placement)

    @cached_property
    def range_derivative(self) -> np.ndarray:
        """Return the derivatives (k, n) by an error of the ranges, per m; positive: too long."""
        nearer = replace(self.model, range_bias=self.model.range_bias + FINITE_STEP_M)
        moved = self.residuals_with(model=nearer)
        return (moved - self.assignment.standardized.T) / FINITE_STEP_M

    def derivative_by_model(
        self, change: Callable[[Any, np.ndarray], Any], steps: Sequence[float] | np.ndarray
    ) -> np.ndarray:
        """Return the derivatives (q, k, n) by values (q,) that change(model, values) applies.

        steps: (q,) finite differences.
        """
        return self._finite_differences(
            lambda values: self.residuals_with(model=change(self.model, values)), steps
        )

    def derivative_by_target(
        self, change: Callable[[Any, np.ndarray], Any], steps: Sequence[float] | np.ndarray
    ) -> np.ndarray:
        """Return the derivatives (q, k, n) by values (q,) that change(target, values) applies."""
        return self._finite_differences(
            lambda values: self.residuals_with(target=change(self.target, values)), steps
        )

    def _finite_differences(
        self,
        residuals_at: Callable[[np.ndarray], np.ndarray],
        steps: Sequence[float] | np.ndarray,
    ) -> np.ndarray:
        before = self.assignment.standardized.T
        rows = zip(np.diag(steps), steps, strict=True)
        return np.stack([(residuals_at(row) - before) / step for row, step in rows])

    def residuals_with(
        self,
        model: Any = None,
        target: Any = None,
        T_sensor_target: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the residuals (k, n), in the same σ, with another model, target or pose.

        A measurement that would then be assigned to another feature keeps its residual.
        """
        g, now = self.group, self.assignment
        changed = RESIDUAL_KINDS[g.kind].assign(
            self.model if model is None else model,
            self.target if target is None else target,
            self.T_sensor_target if T_sensor_target is None else T_sensor_target,
            g.keypoints,
            options=self.setup.associate_options,
            noise=self.state.noise[noise_key(g)],
        )
        same = (changed.candidate_feature == now.candidate_feature)[:, None]
        return replace(now, residual=np.where(same, changed.residual, now.residual)).standardized.T
